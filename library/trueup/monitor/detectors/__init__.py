"""One file for each detector of changes."""
