"""Adapters: one file for each format, each of which says what it reads."""
