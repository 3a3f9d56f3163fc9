"""Recordings, tables, model files and the site file."""
