"""The oscillation measured for its own sake."""
