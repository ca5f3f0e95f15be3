"""``python -m smolbot``."""

from smolbot.cli.app import main

main()
