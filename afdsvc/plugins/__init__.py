"""Hook specifications, the manager, and the families of plugins."""
