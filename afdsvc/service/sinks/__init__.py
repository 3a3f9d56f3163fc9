"""Sinks of the service: recorder, publisher, pre-alarm buffer."""
