"""Is it still so: residuals of the serving model, detectors that follow them, and what they
promise."""
