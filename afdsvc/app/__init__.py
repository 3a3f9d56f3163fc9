"""One file per command: the steps of the command from top to bottom."""
