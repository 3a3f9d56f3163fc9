"""Zenoh sessions, outgoing queues, access rules and certificates."""
