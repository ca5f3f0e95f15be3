"""Devices, sensors and recordings that several rooms of the tests share."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from importlib.metadata import EntryPoint
from itertools import count
from pathlib import Path
from types import ModuleType

# As the command line does: threads of a linear algebra library only wait for each other where workers share the cores.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pytest
from hypothesis import settings

from smolbot.config import plugins
from smolbot.config.mission import Mission, load_steering_mission
from smolbot.config.rig import load_rig
from smolbot.core.pose import Pose
from smolbot.core.rotations import quaternion_from_axes
from smolbot.core.sensing import Device, Recording, SensorArray
from smolbot.localization.forward import compute_deflection, compute_sensor_field
from smolbot.motion.controller import Setup

# No test depends on the wall clock or on what was drawn before.
settings.register_profile("smolbot", deadline=None, derandomize=True, database=None)
settings.load_profile("smolbot")

RATE = 50_000.0
_NUMBERS = count()
UP = np.array([0.0, 0.0, 1.0])


@cache
def mission_of(name: str, **settings: str) -> Mission:
    """A shipped mission to look at, loaded once for all tests of a process: when the first one runs, not before."""
    return load_steering_mission(name, settings={key.replace("__", "."): value for key, value in settings.items()})


@cache
def setup_of(name: str) -> Setup:
    """What that mission's controller may know."""
    return mission_of(name).setup()


@pytest.fixture(autouse=True)
def cold_coils(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """No test begins with coils that another one has warmed; the folder where their heat is kept instead."""
    folder = tmp_path_factory.getbasetemp() / "heat" / str(next(_NUMBERS))
    monkeypatch.setattr("smolbot.flight.safety.heat_store.find_heat_file", lambda rig: folder / f"{rig}.json")
    return folder


@pytest.fixture
def plug_in(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str, str, object], None]]:
    """Makes anything an entry point of ``smolbot.<group>``: ``plug_in(group, name, it)``; None fails when imported."""
    real, own = plugins.entry_points, []

    def install(group: str, name: str, made: object) -> None:
        module = ModuleType(f"plugged_in_{name}")
        setattr(module, "made" if made is not None else "__getattr__", made if made is not None else _fail)
        monkeypatch.setitem(sys.modules, module.__name__, module)
        own.append(EntryPoint(name, f"{module.__name__}:made", f"smolbot.{group}"))
        plugins._find_entry_points.cache_clear()

    monkeypatch.setattr(
        plugins, "entry_points", lambda group: [*real(group=group), *(o for o in own if o.group == group)]
    )
    yield install
    plugins._find_entry_points.cache_clear()


def _fail(name: str) -> object:
    raise ZeroDivisionError("by me")


@pytest.fixture(scope="session")
def array() -> SensorArray:
    """The shipped array with ideal sensors: nothing of a signal is lost in their low pass."""
    return replace(load_rig("tank").sensors, bandwidth=np.inf)


@pytest.fixture(scope="session")
def along_device() -> Device:
    """Moment along the cantilever, damped by glycerol: the gradient robot's."""
    return Device(0.89e-3, np.array([0.0, 0.0, 1.0]), 1.5e-3, np.radians(17.8), 103.5, 31.7, "exponential")


@pytest.fixture(scope="session")
def across_device() -> Device:
    """Moment across the cantilever, damped by solid friction: the paper's model."""
    return Device(0.89e-3, np.array([1.0, 0.0, 0.0]), 1.5e-3, np.radians(30.0), 160.0, 1.1, "linear")


@pytest.fixture
def devices(along_device: Device, across_device: Device) -> dict[str, Device]:
    return {"along": along_device, "across": across_device}


@pytest.fixture(scope="session")
def pose_at() -> Callable[..., Pose]:
    """``pose_at((x, y, z) in mm, heading in degrees, order)``: body axes of `order` along heading and up."""

    def make(place_mm: tuple[float, float, float], heading_deg: float = 0.0, order: str = "zy") -> Pose:
        ahead = np.array([np.cos(np.radians(heading_deg)), np.sin(np.radians(heading_deg)), 0.0])
        return Pose(0.0, np.array(place_mm) * 1e-3, quaternion_from_axes(ahead, UP, order), np.eye(6) * 1e-8)

    return make


@pytest.fixture(scope="session")
def hear() -> Callable[..., Recording]:
    """What ideal sensors hear of a device: the forward model, sample by sample."""

    def make(
        sensors: SensorArray, device: Device, pose: Pose, half_periods: int = 2, *, phase: float = 0.4,
        amplitude: float | None = None, since: float = 0.02, noise: np.ndarray | None = None,
    ) -> Recording:  # fmt: skip
        n = round(half_periods * RATE / (2.0 * device.frequency))
        size = 0.8 * device.theta_max if amplitude is None else amplitude
        theta = compute_deflection(device, since + np.arange(n) / RATE, size, phase)
        field = compute_sensor_field(sensors, device, pose.position, pose.orientation, theta)
        return Recording(field if noise is None else field + noise, RATE, since)

    return make


@pytest.fixture(scope="session")
def line() -> Mission:
    """The shipped mission `line`, loaded once."""
    return mission_of("line")


@pytest.fixture(scope="session")
def missions() -> Path:
    """Folder of the mission files that must not be flown."""
    return Path(__file__).parent / "missions"
