"""One file for each family of nominal models."""
