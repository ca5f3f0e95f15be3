"""Check of a rig file's places: what would stand in the container, in a winding, or where another sensor is.

Coils, bobbins and the container are solids. Two of them meet where a point of one, sampled densely, lies in the other.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from smolbot.config.document import Fault, KeyPath
from smolbot.config.rig_sections import CoilSection, ContainerSection, ExcitationSection, MagnetSection, RigFile
from smolbot.config.sensors import SensorsSection
from smolbot.core.arrays import BoolArray, FloatArray

SAMPLES_AROUND, SAMPLES_ALONG = 720, 9
"""Samples of a winding around its axis, and of any solid along each other direction: 1 mm apart on a coil of 220 mm."""

TOUCH = 1e-6
"""Depth, in m, up to which two solids only touch: a coil may be glued to a wall."""

MIN_SENSOR_DISTANCE = 1e-3
"""Distance, in m, of two sensors of one direction below which they hear the same: smaller than any fluxgate or chip."""

PARALLEL = np.cos(np.radians(2.0))
"""Cosine above which two axes are one: the tilt of a sensor in its case, or of a coil on its bobbin."""

WALLS = (("-x", "+x"), ("-y", "+y"), ("floor", "top"))


class Solid(Protocol):
    """A body in the world frame."""

    def contains(self, points: FloatArray) -> BoolArray:
        """Return which of some points (n, 3), in m, lie in it.

        Parameters
        ----------
        points : ndarray, shape (n, 3), in m

        Returns
        -------
        ndarray of bool, shape (n,)
        """

    def sample(self) -> FloatArray:
        """Return points in it, dense enough to see whether it meets another body.

        Returns
        -------
        ndarray, shape (m, 3), in m
        """


@dataclass(frozen=True, eq=False)
class Block:
    """A box of any orientation: rows of `axes` are its directions, `half` its half sizes along them, in m."""

    center: FloatArray
    axes: FloatArray
    half: FloatArray

    def contains(self, points: FloatArray) -> BoolArray:
        """See `Solid`.

        Parameters
        ----------
        points : ndarray, shape (n, 3), in m

        Returns
        -------
        ndarray of bool, shape (n,)
        """
        return np.all(np.abs((points - self.center) @ self.axes.T) < self.half - TOUCH, axis=1)

    def sample(self) -> FloatArray:
        """See `Solid`.

        Returns
        -------
        ndarray, shape (m, 3), in m
        """
        steps = np.linspace(-1.0, 1.0, 2 * SAMPLES_ALONG + 1)
        grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
        return self.center + (grid * self.half) @ self.axes


@dataclass(frozen=True, eq=False)
class Ring:
    """The winding of a round coil: between two radii around a unit `axis`, within `half_length` of its centre, in m."""

    center: FloatArray
    axis: FloatArray
    inner: float
    outer: float
    half_length: float

    def contains(self, points: FloatArray) -> BoolArray:
        """See `Solid`.

        Parameters
        ----------
        points : ndarray, shape (n, 3), in m

        Returns
        -------
        ndarray of bool, shape (n,)
        """
        along = (points - self.center) @ self.axis
        radius = np.linalg.norm(points - self.center - along[:, None] * self.axis, axis=1)
        inside: BoolArray = np.abs(along) < self.half_length - TOUCH
        return inside & (radius > self.inner + TOUCH) & (radius < self.outer - TOUCH)

    def sample(self) -> FloatArray:
        """See `Solid`.

        Returns
        -------
        ndarray, shape (m, 3), in m
        """
        first, second = make_frame(self.axis)[:2]
        turns = np.linspace(0.0, 2.0 * np.pi, SAMPLES_AROUND, endpoint=False)
        around = np.cos(turns)[:, None] * first + np.sin(turns)[:, None] * second
        radii = np.linspace(self.inner, self.outer, SAMPLES_ALONG)[:, None, None, None]
        places = np.linspace(-self.half_length, self.half_length, SAMPLES_ALONG)[None, :, None, None]
        return (self.center + radii * around + places * self.axis).reshape(-1, 3)


def make_frame(axis: FloatArray) -> FloatArray:
    """Make three directions at right angles.

    Parameters
    ----------
    axis : ndarray, shape (3,)
        A unit vector.

    Returns
    -------
    ndarray, shape (3, 3)
        Right-handed rows, the last along `axis`.
    """
    first = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
    first = first / np.linalg.norm(first)
    return np.array([first, np.cross(axis, first), axis])


def find_geometry_faults(sections: RigFile) -> list[Fault]:
    """Find what stands where nothing of its kind can.

    Parameters
    ----------
    sections : RigFile

    Returns
    -------
    list of Fault
        Empty if there is none.
    """
    solids = list(_list_solids(sections))
    return [
        *(fault for key, name, solid in solids for fault in _find_in_container(key, name, solid, sections.container)),
        *_find_magnet_faults(sections.magnet, sections.container),
        *_find_sensor_faults(sections.sensors, sections.container, solids),
        *_find_excitation_faults(sections.excitation),
    ]


def _list_solids(sections: RigFile) -> Iterator[tuple[KeyPath, str, Solid]]:
    """List every winding and bobbin with its key and name."""
    for k, coil in enumerate(sections.coils):
        yield ("coils", k, "center_mm"), f"coil '{coil.name}'", _make_ring(coil)
    for k, bobbin in enumerate(sections.excitation):
        yield ("excitation", k, "center_mm"), f"excitation coil '{bobbin.name}'", _make_bobbin(bobbin)


def _make_ring(coil: CoilSection) -> Ring:
    axis = np.array(coil.axis, dtype=float)
    return Ring(coil.center, axis / np.linalg.norm(axis), coil.inner_radius, coil.outer_radius, 0.5 * coil.length)


def _make_bobbin(coil: ExcitationSection) -> Block:
    axis = np.array(coil.axis, dtype=float)
    axis = axis / np.linalg.norm(axis)
    wide = np.cross([0.0, 0.0, 1.0], axis)
    if np.linalg.norm(wide) < TOUCH:  # it lies flat, and `RigConfig.flat_coils` has no width to turn
        wide = make_frame(axis)[0]
    wide = wide / np.linalg.norm(wide)
    half = 0.5 * np.array([coil.width, coil.height, coil.length])
    return Block(coil.center, np.array([wide, np.cross(axis, wide), axis]), half)


def _get_inner_space(container: ContainerSection) -> Block:
    """Return the space within the walls, from the floor to their rim."""
    low, high = container.low, container.high
    high[2] = max(high[2], container.floor_z + container.wall_height)
    return Block(0.5 * (low + high), np.eye(3), 0.5 * (high - low))


def _find_in_container(key: KeyPath, name: str, solid: Solid, container: ContainerSection) -> Iterator[Fault]:
    """Find a coil that reaches into the container, and the wall through which it does so least."""
    space = _get_inner_space(container)
    points = solid.sample()
    points = points[space.contains(points)]
    if not len(points):
        if solid.contains(space.sample()).any():
            yield Fault(key, f"the container lies in the winding of {name}; a robot cannot swim there.")
        return
    low, high = space.center - space.half, space.center + space.half
    depths = np.stack([(points - low).max(axis=0), (high - points).max(axis=0)])  # behind the low, the high walls
    side, axis = divmod(int(np.argmin(depths)), 3)
    place = 1e3 * (low, high)[side][axis]
    yield Fault(
        key,
        f"{name} reaches {1e3 * depths.min():.1f} mm into the container, through its {WALLS[axis][side]} wall at "
        f"{'xyz'[axis]} = {place:g} mm; a coil must stay outside. Move it by that much, or make the container smaller.",
    )


def _find_magnet_faults(magnet: MagnetSection | None, container: ContainerSection) -> Iterator[Fault]:
    """Find a magnet that strikes the container when it turns."""
    if magnet is None:
        return
    space = _get_inner_space(container)
    beside = np.maximum(np.abs(magnet.center - space.center) - space.half, 0.0)
    gap, radius = 1e3 * float(np.linalg.norm(beside)), 1e3 * magnet.side / np.sqrt(2.0)
    if gap < radius:
        yield Fault(
            ("magnet", "center_mm"),
            f"the magnet is {gap:.1f} mm from the container, and its edges turn on a radius of {radius:.1f} mm; "
            f"move it {radius - gap:.1f} mm away.",
        )


def _find_sensor_faults(
    section: SensorsSection, container: ContainerSection, solids: list[tuple[KeyPath, str, Solid]]
) -> Iterator[Fault]:
    """Find sensors in the container or a coil, and pairs that hear the same."""
    array, key = section.array, ("sensors", "positions_mm")
    bodies = [("the container, where the robot swims", _get_inner_space(container)), *((n, s) for _, n, s in solids)]
    for k, (place, axis) in enumerate(zip(array.positions, array.axes, strict=True)):
        where = f"sensor {k} at ({', '.join(f'{1e3 * c:.1f}' for c in place)}) mm"
        for name, body in bodies:
            if body.contains(place[None, :])[0]:
                yield Fault((*key, k), f"{where} lies in {name}; move it out.")
        near = np.linalg.norm(array.positions[:k] - place, axis=1) < MIN_SENSOR_DISTANCE
        same = np.flatnonzero(near & (np.abs(array.axes[:k] @ axis) > PARALLEL))
        if same.size:
            yield Fault(
                (*key, k),
                f"{where} hears what sensor {same[0]} hears: same place, same axis. Two sensors of one axis need "
                f"{1e3 * MIN_SENSOR_DISTANCE:g} mm or more between them.",
            )


def _find_excitation_faults(coils: list[ExcitationSection]) -> Iterator[Fault]:
    """Find an excitation coil that stands upright, and two that drive along one axis."""
    axes = [np.array(coil.axis, dtype=float) / np.linalg.norm(coil.axis) for coil in coils]
    for k, axis in enumerate(axes):
        if abs(axis[2]) > PARALLEL:
            message = "has a vertical axis; its width lies in the horizontal plane, so the axis cannot stand upright."
            yield Fault(("excitation", k, "axis"), f"excitation coil '{coils[k].name}' {message}")
    if len(axes) == 2 and abs(axes[0] @ axes[1]) > PARALLEL:
        yield Fault(
            ("excitation", 1, "axis"),
            f"excitation coils '{coils[0].name}' and '{coils[1].name}' have the same axis: a device along it is never "
            "driven. Their axes must differ, at best by 90 degrees.",
        )
