"""Driver of the magnet stage: an Arduino Uno behind a serial port. See ``docs/magnet-stage.md``."""

from smolbot.bench.hardware.stage.stage import MagnetStage

__all__ = ["MagnetStage"]
