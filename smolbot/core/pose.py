"""The device's pose: one estimate of its six degrees of freedom, with its covariance."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

from smolbot.core.arrays import FloatArray, as_floats, freeze
from smolbot.core.results import Readable
from smolbot.core.rotations import matrix_from_quaternion
from smolbot.errors import InputError

UNIT_LENGTH = (0.99, 1.01)
"""Lengths of a quaternion that are accepted and normalised; others are mistakes, not rounding."""


@dataclass(frozen=True, eq=False, repr=False)
class Pose(Readable):
    """One estimate of the device's position and orientation.

    Attributes
    ----------
    time : float, in s
        Middle of the listening window, on the rig's clock.
    position : ndarray, shape (3,), in m, world frame
        The cantilever's rotation centre (origin of Eq. S7); the magnet is ``l0`` away from it.
    orientation : ndarray, shape (4,)
        Unit quaternion, scalar first, takes body vectors to world vectors.
    covariance : ndarray, shape (6, 6)
        Of (position in m, rotation error e in rad), world frame, with R_estimate = exp(e) R_true.
    r_squared : float
        Coefficient of determination of the fit (Eq. S23).
    flip_margin : float
        Residual of the worse over that of the better member of the two-fold ambiguity, at least 1.
    trusted : bool
        False means: do not act on this pose.

    Examples
    --------
    >>> import numpy as np
    >>> import smolbot
    >>> pose = smolbot.Pose(0.1, [0.004, -0.006, 0.06], [1, 0, 0, 0], 1e-8 * np.eye(6))
    >>> print(pose.body_axis("z"), np.sqrt(np.diag(pose.covariance)[:3]))
    [0. 0. 1.] [0.0001 0.0001 0.0001]
    """

    time: float
    position: FloatArray
    orientation: FloatArray
    covariance: FloatArray
    r_squared: float = 1.0
    flip_margin: float = 1.0
    trusted: bool = True

    def __post_init__(self) -> None:
        position = as_floats(self.position, (3,), "Pose position")
        orientation = as_floats(self.orientation, (4,), "Pose orientation")
        length = math.sqrt(orientation @ orientation)
        if not UNIT_LENGTH[0] < length < UNIT_LENGTH[1]:
            raise InputError(f"Pose orientation must be a unit quaternion; got length {length:.4g}.")
        object.__setattr__(self, "position", freeze(position))
        object.__setattr__(self, "orientation", freeze(orientation / length))
        covariance = as_floats(self.covariance, (6, 6), "Pose covariance", finite=False)
        object.__setattr__(self, "covariance", freeze(covariance))

    @cached_property
    def rotation(self) -> FloatArray:
        """Rotation matrix (3, 3) that takes body vectors to world vectors."""
        return matrix_from_quaternion(self.orientation)

    def body_axis(self, axis: str) -> FloatArray:
        """Return the direction of a body axis in the world frame.

        Parameters
        ----------
        axis : {"x", "y", "z"}

        Returns
        -------
        ndarray, shape (3,)
            Unit vector.
        """
        return self.rotation[:, "xyz".index(axis)]

    def at(self, time: float) -> Pose:
        """Return the same estimate with another time stamp.

        Parameters
        ----------
        time : float, in s
            On the rig's clock.

        Returns
        -------
        Pose
        """
        return replace(self, time=time)
