"""Physics with named parameters and units."""
