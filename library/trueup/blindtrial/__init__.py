"""Blind trials: randomly drawn effects hidden in another simulator, their labels committed before
the diagnosis runs."""
