"""Doctor: what is wrong with a log, before anything is blamed on the machine."""
