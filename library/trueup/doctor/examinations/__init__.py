"""Examinations: each looks for some faults of a log, and returns what it finds."""
