"""Randomise: families of plants as data, what they hold, and training episodes drawn from them."""
