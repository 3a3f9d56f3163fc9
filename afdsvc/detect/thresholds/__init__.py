"""Thresholds for designed false-alarm rates, and the power of the tests."""
