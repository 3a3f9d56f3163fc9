"""Recordings in MCAP: written, read, recovered, indexed."""
