"""Numerical parts of the methods: compression, prediction errors, impulse responses."""
