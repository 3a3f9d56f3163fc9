"""Where the service sends what it finds: recorder, publisher, pre-alarm buffer."""
