"""From raw sensor signals to a pose: signal chain, forward model, fit."""
