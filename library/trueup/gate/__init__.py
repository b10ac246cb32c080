"""What we decide: frozen rules over a trial, and the decision that they make."""
