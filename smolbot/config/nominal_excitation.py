"""Nominal field of the excitation coils by the rig file, tabulated once."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from smolbot.config.rig import RigConfig, make_mesh_axis
from smolbot.core.arrays import FloatArray

if TYPE_CHECKING:
    from lookup_tables import FieldTable

MESH_STEP_MM = 2.0  # mm: these coils lie 20 mm or more below the robot, and their field is smooth there
MARGIN_MM = 3.0  # mm beyond the container
CLEARANCE_MM = 6.0  # mm above a winding, below which the mesh is too coarse for its field


class NominalExcitation:
    """Interpolates the field inside the container and a little beyond; computes it elsewhere, and close to a winding.

    Parameters
    ----------
    rig : RigConfig
    """

    def __init__(self, rig: RigConfig) -> None:
        from lookup_tables import TableError, cached_table

        self._coils = rig.flat_coils()
        box = rig.sections.container
        center, half = np.array(box.center_mm), 0.5 * np.array(box.size_mm)
        low = np.array([*(center - half), box.floor_z_mm]) - MARGIN_MM
        tops = [coil.center_mm[2] + 0.5 * coil.height_mm + CLEARANCE_MM for coil in rig.sections.excitation]
        low[2] = max(low[2], min(max(tops), box.surface_z_mm - 2.0 * MESH_STEP_MM))
        high = np.array([*(center + half), max(box.surface_z_mm, box.floor_z_mm + 5.0)]) + MARGIN_MM
        self._low, self._high = 1e-3 * low, 1e-3 * high
        axes = [make_mesh_axis((float(a), float(b)), MESH_STEP_MM) for a, b in zip(low, high, strict=True)]
        self._table: FieldTable | None = None
        with suppress(TableError):  # a bobbin beside the container, or in it
            self._table = cached_table(self._coils, *axes)

    def compute_field(self, position: FloatArray) -> FloatArray:
        """Compute the field of each excitation coil.

        Parameters
        ----------
        position : ndarray, shape (3,), in m
            In the world frame.

        Returns
        -------
        ndarray, shape (n_exc, 3), in T per A
            In the world frame.
        """
        point = np.array(position, dtype=np.float64)[None]
        if self._table is not None and np.all(point >= self._low) and np.all(point <= self._high):
            return np.asarray(self._table.field(point)[:, 0])
        return np.array([coil.field(point)[0] for coil in self._coils])
