"""The laws that families, predictors and rules obey. They find their subjects, so that none is
forgotten."""
