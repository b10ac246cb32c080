"""Measurements: each is a ratio of two things run side by side in one run, or a size. Run all with
`make bench`."""
