"""What sensors and a device that are not exactly as assumed add to the error of a pose.

Near the true pose, whitened data are s + J dx + D q + n, with x pose, phase and amplitude, q the deviations of sensors
and device from the assumed ones, and n white noise. A fit takes part of D q for a change of the pose,

    dx = S q,   S = (J^T J)^-1 J^T D,

and what no pose explains is information on q: D^T D - D^T J (J^T J)^-1 J^T D from every recording.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.sensing import SensorArray
from smolbot.localization.array.terms import DEVIATIONS_OF_DEVICE, DEVIATIONS_PER_SENSOR
from smolbot.localization.bounds import N_PHASES, Response, compute_channel_series

_L0_STEP = 1e-6
"""Step, in m, of the difference quotient for l0."""


def compute_sensor_terms(
    response: Response, frames: FloatArray, positions: FloatArray, rotations: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Compute how poses depend on deviations of sensors and device, and what a recording tells of these.

    Parameters
    ----------
    response : Response
        Of the whitened data, with the assumed sensors and device.
    frames : ndarray, shape (n_sensors, 2, 3)
        Directions of each sensor's tilts, from `compute_tilt_frames`.
    positions : ndarray, shape (n_poses, 3), in m, world frame
    rotations : ndarray, shape (n_poses, 3, 3)
        Rotation matrices, body to world.

    Returns
    -------
    sensitivity : ndarray, shape (n_poses, 6, n)
        Change of position (m) and rotation (rad) with each deviation, averaged over phases.
    information : ndarray, shape (n, n)
        On the deviations by one recording, averaged over poses and phases. The deviations are those of `ArrayPrior`.
    """
    values, slopes = response.compute_series(positions, rotations)
    changes = _compute_series_changes(response, frames, positions, rotations, values, slopes)
    sensitivity, information = [], []
    for phase in np.pi * np.arange(N_PHASES) / N_PHASES:
        jacobian = response.compute_jacobian(values, slopes, float(phase))
        waves, _ = response.compute_waves(float(phase))
        deviated = np.einsum("djk,pjkq->pdq", waves, changes, optimize=True)
        scale = 1.0 / np.sqrt(np.einsum("pdi,pdi->pi", jacobian, jacobian))
        scaled = jacobian * scale[:, None, :]
        mixed = np.swapaxes(scaled, 1, 2) @ deviated
        shift = np.linalg.solve(np.swapaxes(scaled, 1, 2) @ scaled, mixed)
        sensitivity.append((shift * scale[:, :, None])[:, :6])
        information.append(np.mean(np.swapaxes(deviated, 1, 2) @ deviated - np.swapaxes(mixed, 1, 2) @ shift, axis=0))
    return np.mean(sensitivity, axis=0), np.mean(information, axis=0)


def _compute_series_changes(
    response: Response, frames: FloatArray, positions: FloatArray, rotations: FloatArray, values: FloatArray,
    slopes: FloatArray,
) -> FloatArray:  # fmt: skip
    """Compute the change of the power series (n_poses, n_sensors, K, n) of each channel with each deviation."""
    sensors, device = response.sensors, response.device
    n = len(sensors)
    out = np.zeros((*values.shape, DEVIATIONS_PER_SENSOR * n + DEVIATIONS_OF_DEVICE))
    tilted = [
        compute_channel_series(
            SensorArray(sensors.positions, frames[:, k], sensors.bandwidth, sensors.gains), device, positions, rotations
        )[0]
        for k in range(frames.shape[1])
    ]
    for j in range(n):
        own = [values[:, j], *(of[:, j] for of in tilted), *(-slopes[:, j, :, k] for k in range(3))]
        out[:, j, :, DEVIATIONS_PER_SENSOR * j : DEVIATIONS_PER_SENSOR * (j + 1)] = np.stack(own, axis=-1)
    longer, _ = compute_channel_series(sensors, replace(device, l0=device.l0 + _L0_STEP), positions, rotations)
    out[..., -2], out[..., -1] = values, (longer - values) / _L0_STEP
    return out
