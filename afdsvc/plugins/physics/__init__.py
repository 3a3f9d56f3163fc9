"""Built-in physics hypotheses."""
