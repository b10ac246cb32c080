"""Export: a corrected model in the words of other programs, with what is not certain about it."""
