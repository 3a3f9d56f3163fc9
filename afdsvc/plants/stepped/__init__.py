"""Simulators that advance step by step: FMI units and Python functions."""
