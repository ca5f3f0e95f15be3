"""Measure the processor load of the twin's plant: ``python -m sim.measure.plant_speed``."""

from __future__ import annotations

import time
from contextlib import closing

import numpy as np

from sim.tank.settings import TankSettings
from sim.twin.twin_plant import TwinPlant
from smolbot.config.rig import load_rig
from smolbot.config.robot import load_robot

PIECE = 250
"""Samples that the card lets the plant play at once."""


def measure_plant_loads(rig_name: str, robot_name: str, seconds: float = 2.0) -> dict[str, float]:
    """Measure the twin's plant: processor time per second of its own time, with nothing and with everything driven.

    Parameters
    ----------
    rig_name, robot_name : str
        As `load_rig` and `load_robot` find them.
    seconds : float
        Of the plant's time, for each state.

    Returns
    -------
    dict of str to float
    """
    rig = load_rig(rig_name)
    settings = rig.section_of("tank", TankSettings)
    plant = TwinPlant(rig, load_robot(robot_name), settings, np.zeros(2), seed=1)
    still = np.zeros((len(plant.loads), PIECE))
    wave = 3.0 * np.sin(2 * np.pi * 100.0 * np.arange(PIECE) / plant.rate)
    driven = np.tile(wave, (len(plant.loads), 1))
    pieces = round(seconds * plant.rate / PIECE)

    def load(currents: np.ndarray, *, read: bool = False, turning: bool = False) -> float:
        begin = time.process_time()
        for k in range(pieces):
            if turning:
                plant.set_magnet(2 * np.pi * 0.25 * k * PIECE / plant.rate, 0.0, near=True)
            plant.advance(currents)
            if read:
                plant.read_volts(plant.played - PIECE, PIECE)
        return (time.process_time() - begin) * plant.rate / (pieces * PIECE)

    with closing(plant.carrier):
        load(still, read=True), load(driven)  # compiled
        found = {"idle": load(still), "driven": load(driven), "idle and read": load(still, read=True)}
        if rig.sections.magnet is not None:
            found["magnet turning"] = load(still, turning=True)
    return found


def main() -> None:
    """Print the loads of both shipped robots."""
    for rig, robot in (("tank", "gradient"), ("gel", "helical")):
        for state, share in measure_plant_loads(rig, robot).items():
            print(f"{rig}, {state}: {100 * share:.1f} % of a processor, {1 / share:.0f} times real time")


if __name__ == "__main__":
    main()
