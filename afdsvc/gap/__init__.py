"""Where simulation and recordings part: locate, name, model, improve."""
