"""A second simulator: known truths for blind trials, demonstrations and tests. It shares no line
with the models it checks."""
