"""The link between a mission and a console: messages one way, orders the other. Independent of the page."""
