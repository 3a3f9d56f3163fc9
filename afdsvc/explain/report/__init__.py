"""The answer for people and machines: names, fits on held-out recordings, pictures' numbers, JSON."""
