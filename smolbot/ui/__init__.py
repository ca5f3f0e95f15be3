"""A person's ways in: command line, and a page in the browser."""
