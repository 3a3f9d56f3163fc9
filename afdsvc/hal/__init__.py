"""Simulator, replay and rig drivers under one contract."""
