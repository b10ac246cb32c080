"""Recorded commands and observations of one run."""
