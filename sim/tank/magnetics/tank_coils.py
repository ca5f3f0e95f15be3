"""All coils around one tank: actuation, excitation, and the compensation coil for the earth's field."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.tank.magnetics.coil_fields import TIME_CONSTANT, CoilSet, pack_coils
from sim.tank.magnetics.coupling import MU_0, compute_coupling
from sim.tank.mismatch import TankTruth
from sim.tank.settings import TankSettings
from smolbot.config.rig import RigConfig
from smolbot.core.arrays import FloatArray
from smolbot.core.rotations import matrix_from_quaternion, quaternion_from_rotation_vector

MARGIN = 3e-3  # m beyond the container: the magnet is ahead of the housing's middle
MIN_DEPTH_MM, ABOVE_SURFACE_MM = 5.0, 2.0  # least height of the volume over the floor, and its part over the surface
WINDING = (0.95, 1.05, 0.2)  # inner and outer radius and length of the compensation coil, in its radius
EARTH_TURNS = 200.0  # of the compensation coil; only its field matters


@dataclass(frozen=True, eq=False)
class TankCoils:
    """The true coils of one tank; the compensation coil, if any, comes last.

    Attributes
    ----------
    fields : CoilSet
    circuits : ndarray, shape (n_coils, 4)
        Columns as `sim.tank.magnetics.cantilever.advance_cantilever` takes them.
    coupling : ndarray, shape (n_coils, n_sensors), in T/A
        Zero for the compensation coil: its effect on the sensors was nulled manually.
    earth : ndarray, shape (3,), in T
        World frame.
    n_actuation, n_excitation : int
    """

    fields: CoilSet
    circuits: FloatArray
    coupling: FloatArray
    earth: FloatArray
    n_actuation: int
    n_excitation: int

    @classmethod
    def build(
        cls, rig: RigConfig, settings: TankSettings, truth: TankTruth, positions: FloatArray, axes: FloatArray
    ) -> TankCoils:
        """Place every coil with its sampled errors.

        Parameters
        ----------
        rig : RigConfig
        settings : TankSettings
        truth : TankTruth
        positions, axes : ndarray, shape (n_sensors, 3)
            True sensor positions (m) and sensitive directions, world frame.

        Returns
        -------
        TankCoils
        """
        from lookup_tables import FlatCoil, RoundCoil

        driven: tuple[RoundCoil | FlatCoil, ...] = (*rig.round_coils(), *rig.flat_coils())
        circuits = np.zeros((len(driven), 4))
        circuits[:, TIME_CONSTANT] = np.array(rig.time_constants) * truth.coil_time_constants
        rotations = np.array([matrix_from_quaternion(quaternion_from_rotation_vector(t)) for t in truth.coil_tilts])
        coupling = compute_coupling(driven, truth.coil_places, rotations, truth.coil_gains, positions, axes)
        coils = list(driven)
        places, tilts, gains = truth.coil_places, truth.coil_tilts, truth.coil_gains
        earth = settings.earth.field
        strength = float(np.linalg.norm(earth))
        low, high = find_magnet_volume(rig)
        if settings.earth.compensated and strength > 0:
            section, middle = settings.earth, 0.5 * (low + high)
            radius, direction = section.coil_radius, -earth / strength
            inner, outer, length = (share * radius for share in WINDING)
            center = middle - section.coil_distance * direction
            external = RoundCoil("earth", center, direction, inner, outer, length, EARTH_TURNS)
            # field of its loops on the axis, in T per A
            away = section.coil_distance
            per_ampere = sum(
                0.5 * MU_0 * external.turns * share * r**2 / (r**2 + (away - along) ** 2) ** 1.5
                for r, along, share in external.loops()
            )
            coils.append(external)
            places, tilts = np.vstack([places, np.zeros(3)]), np.vstack([tilts, truth.compensation_tilt])
            gains = np.append(gains, truth.compensation_gain)
            current = strength / per_ampere
            circuits = np.vstack([circuits, [current, current, 0.0, 0.0]])
            coupling = np.vstack([coupling, np.zeros(len(positions))])
        fields = pack_coils(tuple(coils), places, tilts, gains, low, high)
        return cls(fields, circuits, coupling, earth, len(rig.sections.coils), len(rig.sections.excitation))


def find_magnet_volume(rig: RigConfig) -> tuple[FloatArray, FloatArray]:
    """Return the corners of the space in which the magnet can be.

    Parameters
    ----------
    rig : RigConfig

    Returns
    -------
    low, high : ndarray, shape (3,), in m
        World frame.
    """
    box = rig.container
    top_mm = max(box.surface_z_mm, box.floor_z_mm + MIN_DEPTH_MM) + ABOVE_SURFACE_MM  # the mesh's last digit needs mm
    return box.low - MARGIN, np.array([*box.high[:2], 1e-3 * top_mm]) + MARGIN


class TabulatedExcitation:
    """Field of the excitation coils at their nominal positions; fast inside the container's volume.

    Parameters
    ----------
    rig : RigConfig
    """

    def __init__(self, rig: RigConfig) -> None:
        self._coils = rig.flat_coils()
        self._low, self._high = find_magnet_volume(rig)
        n = len(self._coils)
        self._fields = pack_coils(self._coils, np.zeros((n, 3)), np.zeros((n, 3)), np.ones(n), self._low, self._high)

    def compute_field(self, position: FloatArray) -> FloatArray:
        """Compute the field of each excitation coil at a point.

        Parameters
        ----------
        position : ndarray, shape (3,), in m
            World frame.

        Returns
        -------
        ndarray, shape (n_exc, 3), in T per A
            World frame.
        """
        from sim.tank.magnetics.cantilever import compute_fields

        point = np.array(position, dtype=np.float64)[None]
        if np.all(point >= self._low) and np.all(point <= self._high):
            return np.asarray(compute_fields(point, self._fields.rows, self._fields.coefficients)[:, 0])
        return np.array([coil.field(point)[0] for coil in self._coils])
