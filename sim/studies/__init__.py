"""Studies of localization: Monte-Carlo on a bench of the tank's own sensors, each with a table and a figure."""
