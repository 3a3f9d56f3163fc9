"""Recordings like those of real machines: many families, excitation that does not repeat, noise that nobody states."""
