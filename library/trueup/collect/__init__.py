"""How to record what is missing: excitations that stay inside the envelope, and the coverage of a
recording."""
