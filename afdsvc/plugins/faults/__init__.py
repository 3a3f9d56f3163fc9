"""Built-in fault kinds."""
