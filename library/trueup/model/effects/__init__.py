"""The catalogue: one effect in each file."""
