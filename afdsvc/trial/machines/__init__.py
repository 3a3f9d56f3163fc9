"""Machines whose recordings are made up: constants, axes, controllers."""
