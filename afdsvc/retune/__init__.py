"""Retuning the running controller through Q: design for a damaged machine, and the proof that comes before anything moves."""
