"""Parametrisations: structures with physical parameters, their noise and gradients."""
