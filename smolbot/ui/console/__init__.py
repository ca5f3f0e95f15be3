"""The page that shows missions and stops them, in a process of its own."""
