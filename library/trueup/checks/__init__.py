"""The laws that effects, families, rules, detectors and predictors obey. They discover their
subjects, so that none is left out."""
