"""User interfaces: command line, and a page in the browser."""
