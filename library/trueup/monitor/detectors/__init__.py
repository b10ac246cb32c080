"""One file for each way to detect a change."""
