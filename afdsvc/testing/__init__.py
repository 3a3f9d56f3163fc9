"""Shipped to plugin authors: conformance suites and fixtures."""
