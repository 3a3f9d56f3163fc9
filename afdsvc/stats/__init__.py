"""Statistics shared by all methods: whiteness, periodic parts, tones, coloured noise, least squares."""
