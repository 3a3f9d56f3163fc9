"""MCAP recordings, foreign tables, model files."""
