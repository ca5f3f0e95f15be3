"""The mission's side of a live page: what it sends, and the orders that it takes. Knows no page."""
