"""Diagnosis: where a gap lies, which effect causes it, how far it shrinks, and what would tell
more."""
