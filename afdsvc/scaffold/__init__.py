"""A new plugin as a package that installs, conforms and can be read in one go."""
