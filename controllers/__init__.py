"""Controllers: each turns poses into commands, and registers as an entry point of ``smolbot.controllers``."""
