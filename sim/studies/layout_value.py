"""Value of a sensor layout: the bound over a volume, and the error that small sensor errors cause."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.rotations import matrix_from_quaternion
from smolbot.core.sensing import Device, SensorArray
from smolbot.localization.bounds import Bound, ListeningWindow, Response, compute_channel_series
from smolbot.localization.noise.model import NoiseModel

HALF_WIDTH = 0.075
"""Half the side of the square in which sensors may be placed, in m."""

MIN_DISTANCE = 0.010
"""Smallest distance of two sensors, in m: fluxgates have a body, and measure each other's drive."""

AXES = np.eye(3)

N_PHASES = 2
"""Phases of the oscillation, over half a turn, across which errors are averaged."""


@dataclass(frozen=True)
class Mismatch:
    """Errors of a sensor, one standard deviation: m per axis, share of the gain, rad per axis."""

    place: float = 0.2e-3
    gain: float = 0.005
    tilt: float = float(np.radians(0.3))


@dataclass(frozen=True, eq=False)
class Poses:
    """Positions (n, 3) in m and rotation matrices (n, 3, 3) on which a layout is evaluated."""

    positions: FloatArray
    rotations: FloatArray

    def __len__(self) -> int:
        return len(self.positions)


@dataclass(frozen=True)
class Volume:
    """Box in which the device may be, in m."""

    low: tuple[float, float, float] = (-0.020, -0.020, 0.050)
    high: tuple[float, float, float] = (0.020, 0.020, 0.100)

    def make_poses(self, per_axis: int, turns: int, seed: int) -> Poses:
        """Make positions on a grid, faces included, each in random orientations.

        Parameters
        ----------
        per_axis : int
            Grid points per axis.
        turns : int
            Orientations per position, uniform over rotations.
        seed : int

        Returns
        -------
        Poses
        """
        rng = np.random.default_rng(seed)
        lines = [np.linspace(a, b, per_axis) for a, b in zip(self.low, self.high, strict=True)]
        grid = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
        draws = rng.standard_normal((len(grid) * turns, 4))
        draws /= np.linalg.norm(draws, axis=1, keepdims=True)
        return Poses(np.repeat(grid, turns, axis=0), np.array([matrix_from_quaternion(q) for q in draws]))


@dataclass(frozen=True, eq=False)
class LayoutValue:
    """Errors of a layout for one device, pose by pose.

    Attributes
    ----------
    bound : Bound
    systematic : ndarray, shape (n, 3, 3), in m²
        Covariance of position errors that misplaced sensors and wrong gains leave, over sampled layouts.
    """

    bound: Bound
    systematic: FloatArray

    @property
    def systematic_rms(self) -> FloatArray:
        """Root mean square per axis at each pose, shape (n,), in m."""
        return np.sqrt(np.trace(self.systematic, axis1=1, axis2=2) / 3.0)


def evaluate_layout_value(
    sensors: SensorArray, device: Device, noise: NoiseModel, window: ListeningWindow, poses: Poses, mismatch: Mismatch
) -> LayoutValue:
    """Compute the bound, and to first order the effect of small sensor errors on an estimator that reaches it.

    Parameters
    ----------
    sensors : SensorArray
    device : Device
    noise : NoiseModel
    window : ListeningWindow
    poses : Poses
    mismatch : Mismatch

    Returns
    -------
    LayoutValue
    """
    response = Response(sensors, device, noise, window)
    values, slopes = response.compute_series(poses.positions, poses.rotations)
    bound = response.compute_bound(poses.positions, poses.rotations)
    changes = _differentiate_by_sensors(sensors, device, poses, mismatch, values, slopes)
    phases = np.pi * np.arange(N_PHASES) / N_PHASES
    total = np.zeros((len(poses), 3, 3))
    for phase in phases:
        jacobian = response.compute_jacobian(values, slopes, float(phase))
        now, _ = response.compute_waves(float(phase))
        scale = 1.0 / np.sqrt(np.einsum("nma,nma->na", jacobian, jacobian))
        scaled = jacobian * scale[:, None, :]
        turned = np.swapaxes(scaled, 1, 2)
        gain = np.linalg.solve(turned @ scaled, turned)[:, :3] * scale[:, :3, None]
        through = (gain @ now.reshape(len(now), -1)).reshape(len(poses), 3, *now.shape[1:])
        moved = np.einsum("najk,njkp->najp", through, changes)
        total += np.einsum("najp,nbjp->nab", moved, moved) / len(phases)
    return LayoutValue(bound, total)


def _differentiate_by_sensors(
    sensors: SensorArray, device: Device, poses: Poses, mismatch: Mismatch, values: FloatArray, slopes: FloatArray
) -> FloatArray:
    """Compute what one sigma of each sensor's six errors adds to its power series, shape (n, n_sensors, K, 6)."""
    parts = [mismatch.place * slopes[..., i] for i in range(3)] + [mismatch.gain * values]
    for side in find_side_axes(sensors.axes):
        tilted = compute_channel_series(replace(sensors, axes=side), device, poses.positions, poses.rotations)[0]
        parts.append(mismatch.tilt * tilted)
    return np.stack(parts, axis=-1)


def find_side_axes(axes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two directions across each axis.

    Parameters
    ----------
    axes : ndarray, shape (n, 3)

    Returns
    -------
    first, second : ndarray, shape (n, 3)
        Unit vectors.
    """
    seed = np.eye(3)[np.argmin(np.abs(axes), axis=1)]
    first = np.cross(axes, seed)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(axes, first)
