"""The twin: a simulated tank behind the protocols of a bench, in real time."""
