"""Many systems on the same sequences: a matrix, and what can be said of their differences."""
