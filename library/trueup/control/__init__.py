"""Closed loops: a planner, the loop around a plant, an estimator for delayed observations, and a
watchdog."""
