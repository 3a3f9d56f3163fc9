"""Finite-element rotors on magnetic bearings, and rotors modelled with ROSS."""
