"""Coil currents for a requested force: the true force on a moment that has aligned with the field."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from controllers.allocation import compute_field_and_force, compute_max_single_coil, search_currents
from smolbot.core.arrays import FloatArray, as_floats
from smolbot.errors import InputError, SmolbotError

if TYPE_CHECKING:
    from lookup_tables import FieldTable
    from smolbot.motion.controller import Setup

STEPS, STEPS_OF_BOTH, STEPS_OF_FEW = 12, 24, 48
"""Directions of the field tried per quarter turn, before the best are refined: head first, by either end (whose peaks
are narrower), and with three coils, which leave no other freedom."""

MAX_FIELD_SLOPES = (0.3, 10.0)
"""Tangents of the field's slope out of the plane, tried in turn: a floating robot hardly follows the second."""

DIRECTION_SLACK = float(np.tan(np.radians(0.1)))
"""Allowed tangent of every direction error: at a symmetry of the coils it increases the force considerably."""

DIRECTION_OFFSETS = np.radians([0.5, 1.0, 1.5, 2.0, 2.5, 3.0])
"""Angles by which a direction may be missed, tried in this order where the requested one is out of reach or weak."""

WEAK_PULL_SHARE = 0.1
"""Share of the strongest single coil's pull below which a force in the exact direction counts as weak."""


class UnreachableForceError(SmolbotError, ValueError):
    """No currents within the limits give the requested force.

    Parameters
    ----------
    message : str
    most : float, in N
        The strongest force in that direction; 0 where none points there. An attribute of the error too.
    """

    def __init__(self, message: str = "", /, *, most: float = 0.0) -> None:
        super().__init__(message)
        self.most = most


@dataclass(frozen=True)
class Allocation:
    """Currents, and their effect on an aligned moment by the table.

    Attributes
    ----------
    currents : ndarray, shape (n_coils,), in A
    field : ndarray, shape (3,), in T, world frame
    force : ndarray, shape (3,), in N, world frame
        ``|m| grad|B|``. The surface supports the part out of the plane.
    direction_error : float, in rad
        Angle between the requested direction and the force, in the horizontal plane.
    """

    currents: FloatArray
    field: FloatArray
    force: FloatArray
    direction_error: float

    @property
    def head_first(self) -> bool:
        """Whether the force pulls at the head of an aligned robot, not at its tail."""
        return bool(self.force[:2] @ self.field[:2] >= -1e-9 * np.linalg.norm(self.force) * np.linalg.norm(self.field))


@dataclass(frozen=True)
class ForceReach:
    """Strongest force for each direction in the horizontal plane.

    Attributes
    ----------
    angles : ndarray, shape (n,), in rad
        From x toward y.
    force : ndarray, shape (n,), in N
        0 where no currents give a force that points there.
    """

    angles: FloatArray
    force: FloatArray

    @property
    def polygon(self) -> FloatArray:
        """Corners (n, 2) of the polygon of possible forces, in N."""
        return self.force[:, None] * np.stack([np.cos(self.angles), np.sin(self.angles)], axis=1)


class ForceAllocator:
    """Finds currents whose force points in a given direction of the horizontal plane.

    The force on a robot whose magnet has turned into the field B is ``F = |m| grad|B|`` (not a force along B). The
    field's direction is free; of all solutions, the one with the strongest force is chosen, or with the least heat
    for a force of a requested size.

    Parameters
    ----------
    table : FieldTable
    max_current : float or array_like, shape (n_coils,), in A
    moment : float, in A·m²
    unipolar : bool
        True where a supply cannot reverse: currents from 0 on, otherwise from ``-max_current`` on.
    head_first : bool
        Pull at the head only (F.m >= 0), so that the cantilever does not buckle. False: at the better end.
    least_field : float, in T
        Weaker fields are not used. The strongest forces need coils that oppose each other, and so have almost no
        field; a robot that must turn within tens of ms needs a millitesla or more.
    tolerance : float, in rad
        Allowed error of the direction where no force, or only a weak one, points there exactly.

    Raises
    ------
    InputError
        If a current, the moment or `least_field` is not positive.

    Examples
    --------
    >>> from smolbot import load_mission
    >>> setup = load_mission("line").setup()
    >>> allocator = ForceAllocator(setup.table, 8.0, 0.89e-3, least_field=1e-3)
    >>> here = np.array([0.008, 0.0, 0.060])
    >>> print(allocator.currents(here, np.array([0.0, 1.0, 0.0]), force=60e-6).round(1))
    [0.  0.1 3.  0.7]
    """

    @classmethod
    def of(cls, setup: Setup, *, head_first: bool, least_field: float) -> ForceAllocator:
        """Make the allocator of a controller from its setup.

        Parameters
        ----------
        setup : Setup
        head_first : bool
            Pull at the head only.
        least_field : float, in T
            Weaker fields are not used.

        Returns
        -------
        ForceAllocator
        """
        most, unipolar = setup.limits.max_current, setup.limits.unipolar
        return cls(
            setup.table, most, setup.robot.moment, unipolar=unipolar, head_first=head_first, least_field=least_field
        )

    def __init__(
        self,
        table: FieldTable,
        max_current: float | npt.ArrayLike,
        moment: float,
        *,
        unipolar: bool = True,
        head_first: bool = True,
        least_field: float = 2e-5,
        tolerance: float = float(np.radians(3.0)),
    ) -> None:
        self.table = table
        self.moment = float(moment)
        self.head_first = head_first
        self.least_field = float(least_field)
        self._high = np.array(np.broadcast_to(np.asarray(max_current, dtype=np.float64), (table.n_coils,)))
        if not (np.all(np.isfinite(self._high)) and np.all(self._high > 0.0) and self.moment > 0.0):
            raise InputError(f"max_current and moment must be above 0; got {max_current!r} A and {moment!r} A·m².")
        if not self.least_field > 0.0:
            raise InputError(f"least_field must be above 0: without a field no moment aligns; got {least_field} T.")
        self._low = np.zeros(table.n_coils) if unipolar else -self._high
        self._steps = STEPS_OF_FEW if table.n_coils <= 3 else STEPS if head_first else STEPS_OF_BOTH
        self._nudges = DIRECTION_OFFSETS[tolerance + 1e-9 >= DIRECTION_OFFSETS]

    def currents(self, position: FloatArray, direction: FloatArray, force: float | None = None) -> FloatArray:
        """Compute the currents for a force; see `allocate`.

        Parameters
        ----------
        position : ndarray, shape (3,), in m, world frame
            Of the magnet.
        direction : ndarray, shape (3,), world frame
            Horizontal, of any length above 0.
        force : float, in N, optional
            Requested size, at the least heat; by default the strongest.

        Returns
        -------
        ndarray, shape (n_coils,), in A

        Raises
        ------
        UnreachableForceError
            If no currents give this force.
        """
        return self.allocate(position, direction, force).currents

    def allocate(self, position: FloatArray, direction: FloatArray, force: float | None = None) -> Allocation:
        """Compute the currents for a force, and their effect.

        Parameters
        ----------
        position : ndarray, shape (3,), in m, world frame
            Of the magnet.
        direction : ndarray, shape (3,), world frame
            Horizontal, of any length above 0.
        force : float, in N, optional
            Requested size, at the least heat; by default the strongest.

        Returns
        -------
        Allocation

        Raises
        ------
        UnreachableForceError
            If no currents give this force; the message states what is possible instead.
        OutsideTableError
            For a position that the table does not cover.
        InputError
            For a direction that is not horizontal, or has no length.
        """
        position = as_floats(position, (3,), "position")
        way = self._normalize_direction(as_floats(direction, (3,), "direction"))
        if force is not None and not force >= 0.0:
            raise InputError(f"force must not be below 0 N; got {force}. Turn the direction instead.")
        field, gradient = self._evaluate_coils(position)
        requested = -1.0 if force is None else float(force) / self.moment
        found = self._find_currents(field, gradient, way, requested)
        if found is None:
            raise self._make_unreachable_error(position, field, gradient, way, force)
        total, slope = compute_field_and_force(field, gradient, found)
        across, along = way[0] * slope[1] - way[1] * slope[0], way[0] * slope[0] + way[1] * slope[1]
        miss = abs(math.atan2(across, along)) if found.any() else 0.0
        return Allocation(found, total, self.moment * slope, miss)

    def reach(self, position: FloatArray, directions: int = 72) -> ForceReach:
        """Compute the strongest force at a position for equally spaced directions of the plane.

        Parameters
        ----------
        position : ndarray, shape (3,), in m, world frame
            Of the magnet.
        directions : int
            Number of directions.

        Returns
        -------
        ForceReach
        """
        field, gradient = self._evaluate_coils(as_floats(position, (3,), "position"))
        angles = np.asarray(np.arange(directions) * (2.0 * np.pi / directions), dtype=np.float64)
        force = np.zeros(directions)
        for i, angle in enumerate(angles):
            force[i] = self._compute_max_force(field, gradient, np.array([np.cos(angle), np.sin(angle)]))
        return ForceReach(angles, force)

    def _evaluate_coils(self, position: FloatArray) -> tuple[FloatArray, FloatArray]:
        field, gradient = self.table.field_and_gradient(position[None, :])
        return np.ascontiguousarray(field[:, 0]), np.ascontiguousarray(gradient[:, 0])

    def _normalize_direction(self, direction: FloatArray) -> FloatArray:
        length = float(np.linalg.norm(direction))
        if length == 0.0 or abs(direction[2]) > 1e-6 * length:
            given = f"got {direction.tolist()}."
            raise InputError(f"direction must be horizontal and have a length: a surface holds the height; {given}")
        return np.asarray(direction[:2] / length)

    def _search_direction(
        self, field: FloatArray, gradient: FloatArray, way: FloatArray, requested: float
    ) -> tuple[float, FloatArray]:
        """Compute grad|B| along `way` in T/m, not above 0 where no solution exists, and its currents."""
        for slope in MAX_FIELD_SLOPES:
            value, currents = search_currents(
                field, gradient, self._low, self._high, way, requested, self.least_field, slope, DIRECTION_SLACK,
                self.head_first, self._steps,
            )  # fmt: skip
            if value > -1e299:
                break
        return value, currents

    def _find_currents(
        self, field: FloatArray, gradient: FloatArray, way: FloatArray, requested: float
    ) -> FloatArray | None:
        """Find currents for `way`; where there are none, or weak ones, for a direction within the tolerance."""
        if requested == 0.0:
            return np.zeros(len(field))
        value, currents = self._search_direction(field, gradient, way, requested)
        enough = requested
        if requested < 0.0:
            enough = WEAK_PULL_SHARE * compute_max_single_coil(field, gradient, self._high)
        for nudge in self._nudges:
            if value > 0.0 and value >= enough * (1.0 - 1e-6):
                break
            for turn in (-nudge, nudge):
                c, s = np.cos(turn), np.sin(turn)
                beside = np.array([c * way[0] - s * way[1], s * way[0] + c * way[1]])
                other, found = self._search_direction(field, gradient, beside, requested)
                if other > value:
                    value, currents = other, found
        return currents if value > 0.0 else None

    def _compute_max_force(self, field: FloatArray, gradient: FloatArray, way: FloatArray) -> float:
        found = self._find_currents(field, gradient, way, -1.0)
        if found is None:
            return 0.0
        return self.moment * float(np.linalg.norm(compute_field_and_force(field, gradient, found)[1][:2]))

    def _make_unreachable_error(
        self, position: FloatArray, field: FloatArray, gradient: FloatArray, way: FloatArray, force: float | None
    ) -> UnreachableForceError:
        angle = np.degrees(np.arctan2(way[1], way[0]))
        where = f"at ({position[0] * 1e3:.1f}, {position[1] * 1e3:.1f}) mm toward {angle:.0f}°"
        most = 0.0 if force is None else self._compute_max_force(field, gradient, way)
        if most > 0.0 and force is not None:
            possible = f"{most * 1e6:.0f} µN at most"
            return UnreachableForceError(
                f"A force of {force * 1e6:.0f} µN {where} is out of reach: {possible}.", most=most
            )
        ends = "head first" if self.head_first else "with either end first"
        hint = " Allowing the tail first may help." if self.head_first else ""
        return UnreachableForceError(f"No currents pull {where}, {ends}.{hint}")
