"""The background service of a site: hub, bursts, operator requests, notifications, sinks, console."""
