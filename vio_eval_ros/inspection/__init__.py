"""What is wrong with the sensor streams of a recording; start reading at recording.py."""
