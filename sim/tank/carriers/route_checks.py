"""Check that an operator's routes, or a device's position, lie in the container; run when the rig file is read."""

from __future__ import annotations

from typing import Any

import numpy as np

from sim.tank.carriers.endoscope_operator import build_routes
from sim.tank.settings import TankSettings
from smolbot.config.document import Fault, KeyPath
from smolbot.core.arrays import FloatArray

MAX_SCATTER_SIGMAS = 2.0  # standard deviations by which a sampled point may deviate
TREMORS = 2.0  # amplitudes by which tremor may move it
ROUNDING = 1e-9  # mm
N_ROUTE_POINTS = 200  # points of a route that are checked


def check_routes_and_place(settings: TankSettings, container: Any) -> list[Fault]:
    """Check ``[tank.hand]`` and ``[tank.place]`` against the ``[container]`` section.

    Parameters
    ----------
    settings : TankSettings
    container : Any
        The section as read, unchecked.

    Returns
    -------
    list of Fault
    """
    if settings.hand is not None and settings.place is not None:
        return [Fault(("tank", "place"), "a device is guided by [tank.hand] or rests at [tank.place], not both.")]
    box = _read_corners(container)
    if box is None:  # its own faults are reported elsewhere
        return []
    low, high = box
    faults: list[Fault] = []
    if settings.hand is not None:
        room = MAX_SCATTER_SIGMAS * settings.hand.scatter_mm + TREMORS * settings.hand.tremor_mm
        for index, route in enumerate(build_routes(settings.hand)):
            places = 1e3 * route.interpolate_positions(np.linspace(0.0, route.length, N_ROUTE_POINTS))
            faults += _find_outside(places, low, high, room, ("tank", "hand", "routes", index, "points_mm"))
    if settings.place is not None:
        place = np.array([settings.place.position_mm])
        sideways = MAX_SCATTER_SIGMAS * settings.place.scatter_mm * np.array([1.0, 1.0, 0.0])
        faults += _find_outside(place, low, high, sideways, ("tank", "place", "position_mm"))
    return faults


def _find_outside(places: FloatArray, low: FloatArray, high: FloatArray, room: Any, key: KeyPath) -> list[Fault]:
    off = np.flatnonzero(np.any((places < low + room - ROUNDING) | (places > high - room + ROUNDING), axis=1))
    if not off.size:
        return []
    x, y, z = places[off[0]]
    a, b = low + room, high - room
    return [
        Fault(
            key,
            f"({x:.1f}, {y:.1f}, {z:.1f}) mm lies outside the container; with its random scatter there is room for "
            f"x {a[0]:.1f} to {b[0]:.1f}, y {a[1]:.1f} to {b[1]:.1f}, z {a[2]:.1f} to {b[2]:.1f} mm.",
        )
    ]


def _read_corners(container: Any) -> tuple[FloatArray, FloatArray] | None:
    """Return the container's corners (3,) and (3,) in mm, or None if its section is invalid."""
    try:
        center, size = np.array(container["center_mm"], dtype=float), np.array(container["size_mm"], dtype=float)
        floor, surface = float(container["floor_z_mm"]), float(container["surface_z_mm"])
        return np.array([*(center - 0.5 * size), floor]), np.array([*(center + 0.5 * size), surface])
    except (KeyError, TypeError, ValueError):
        return None
