"""Types and protocols shared by all packages."""
