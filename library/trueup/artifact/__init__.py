"""Predictors as data: a canonical manifest, arrays, and the digest that names both."""
