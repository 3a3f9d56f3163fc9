"""Blind trials: a truth written apart from everything it tests."""
