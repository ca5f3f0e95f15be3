"""How robots move, by the controller's model."""
