"""The loop that flies a mission, and everything that it asks."""
