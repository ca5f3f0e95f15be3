"""Tanks to test: the shipped rig and robot, with settings laid over."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from sim.tank.rig import TankRig
from sim.tank.world import TankWorld
from smolbot.config.rig import RigConfig, load_rig
from smolbot.config.robot import RobotConfig, load_robot


@pytest.fixture(scope="session")
def rig() -> RigConfig:
    return load_rig("tank")


@pytest.fixture(scope="session")
def robot() -> RobotConfig:
    return load_robot("gradient")


@pytest.fixture
def open_tank(robot: RobotConfig) -> Iterator[Callable[..., TankRig]]:
    """Open tanks that are closed after the test: ``open_tank(seed=1, start=(0, 0), ideal=False, **settings)``."""
    opened: list[TankRig] = []

    def open_one(
        seed: int = 1, start: tuple[float, float] = (0.0, 0.0), ideal: bool = False, **settings: str
    ) -> TankRig:
        config = load_rig("tank", {key.replace("__", "."): value for key, value in settings.items()})
        opened.append(TankWorld.open(config, robot, start, seed, ideal=ideal))
        return opened[-1]

    yield open_one
    for tank in opened:
        tank.close()
