"""Closed loops: a planner, the loop around a plant, the remedy for delayed observations, and the
watchdog."""
