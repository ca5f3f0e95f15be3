"""What robots do under a command, as the controller believes it."""
