"""Tables, figures and HTML."""
