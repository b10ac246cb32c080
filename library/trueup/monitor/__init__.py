"""Residuals of the serving model, detectors that follow them, and the false-alarm rates that they
promise."""
