"""Simulation of the nominal model, linear or Python code, with effects at its inputs, forces and outputs."""
