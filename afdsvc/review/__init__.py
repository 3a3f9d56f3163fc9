"""Rerun logging and blueprint."""
