"""What we believe: plants, their dynamics, and predictors."""
