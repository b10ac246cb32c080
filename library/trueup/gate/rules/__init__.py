"""One file for each gate rule."""
