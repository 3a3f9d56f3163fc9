"""Thresholds for promised false-alarm rates, and the power of the tests."""
