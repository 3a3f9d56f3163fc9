"""Model files: MODEL.toml read and written."""
