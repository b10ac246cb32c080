"""How to record what is missing: excitations that stay inside the envelope, and what a recording
covers."""
