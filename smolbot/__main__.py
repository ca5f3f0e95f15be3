"""``python -m smolbot``."""

from smolbot.ui.cli.app import main

main()
