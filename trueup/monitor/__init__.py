"""Is it still so: residuals of the serving model and thresholds on them."""
