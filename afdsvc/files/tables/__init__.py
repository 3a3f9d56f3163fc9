"""Tables and recordings made by other tools."""
