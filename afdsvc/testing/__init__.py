"""For plugin authors: conformance suites, and new plugins as packages from templates."""
