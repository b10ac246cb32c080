"""Blind trials: effects hidden by lot in another simulator, their labels committed before the
diagnosis runs."""
