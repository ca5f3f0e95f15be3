"""A lab's own helical law: keeps every promise of smolbot.Controller, and none beyond."""

from controllers import Helical


class Mine:
    """The helical law behind a class that knows nothing else of it."""

    kinds = ("helical",)
    gains = Helical.gains

    def __init__(self, setup, gains):
        self._law = Helical(setup, gains)

    def reset(self, path, pose):
        """Begin a path."""
        self._law.reset(path, pose)

    def command(self, pose):
        """As the law says."""
        return self._law.command(pose)

    def reach(self, path):
        """As the law says."""
        return self._law.reach(path)
