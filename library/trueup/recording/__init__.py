"""Recordings: what a team's files hold, whatever their format, and how they become episodes."""
