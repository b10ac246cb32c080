"""What happened: recorded commands and observations of one run."""
