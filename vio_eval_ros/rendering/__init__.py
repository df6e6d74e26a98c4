"""What every report is drawn and written with: pages, figures, text and files."""
