"""The nouns and protocols everybody agrees on."""
