"""A lab's own world: everything that smolbot.config.World promises, with its own section [ours] in the rig file."""

from sim import TankWorld


class OurWorld(TankWorld):
    """The tank under another name."""

    @staticmethod
    def check(document):
        """No fault: any [ours] will do."""
        return []
