"""The error to expect of a pose: by noise, and by sensors and a device that are not exactly as the files say."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smolbot.config.feasibility import compute_expected_covariances, make_listening_window, make_noise_levels
from smolbot.config.mission_base import MissionBase
from smolbot.config.plugins import load_plugin
from smolbot.core.arrays import FloatArray
from smolbot.core.rotations import matrix_from_quaternion
from smolbot.localization.array.filter import compute_tilt_frames
from smolbot.localization.array.terms import DEVIATIONS_OF_DEVICE
from smolbot.localization.bounds import Response
from smolbot.localization.sensor_uncertainty import compute_sensor_terms


@dataclass(frozen=True, eq=False)
class ExpectedErrors:
    """Covariances of poses at some points, before and while a flight learns what its sensors are off.

    Attributes
    ----------
    noise : ndarray, shape (n, 6, 6), in m and rad
        By noise alone.
    sensitivity : ndarray, shape (n, 6, m)
        Change of a pose with each deviation of sensors and device.
    deviations : ndarray, shape (m, m)
        Covariance of these deviations, as the files state it.
    information : ndarray, shape (m, m)
        What a flight learns of them from one recording; zero if its estimator learns nothing.
    """

    noise: FloatArray
    sensitivity: FloatArray
    deviations: FloatArray
    information: FloatArray

    @classmethod
    def expect(
        cls, mission: MissionBase, points: FloatArray, orientations: list[FloatArray], amplitudes: FloatArray
    ) -> ExpectedErrors:
        """Compute the errors to be expected of a mission's estimator.

        Parameters
        ----------
        mission : MissionBase
        points : ndarray, shape (n, 3), in m, world frame
        orientations : list of ndarray, shape (4,)
            Unit quaternions, one for each point.
        amplitudes : ndarray, shape (n,), in rad
            Of the swing at the end of the excitation.

        Returns
        -------
        ExpectedErrors
        """
        rig, device = mission.rig, mission.robot.device
        noise = compute_expected_covariances(mission, points, orientations, amplitudes)
        levels = make_noise_levels(rig).make_model(rig.sensors)
        response = Response(
            rig.sensors, device, levels, make_listening_window(mission), amplitude=float(np.mean(amplitudes))
        )
        rotations = np.array([matrix_from_quaternion(q) for q in orientations])
        frames = compute_tilt_frames(rig.sections.sensors.array)
        sensitivity, information = compute_sensor_terms(response, frames, points, rotations)
        deviations = _expect_deviations(mission)
        estimator = load_plugin("estimators", mission.base.localization.estimator)
        learns = rig.sensor_covariance is not None and "sensors" in estimator.learns
        return cls(noise, sensitivity, deviations, information if learns else np.zeros(information.shape))

    def compute_sensor_part(self, recordings: float = 0.0) -> FloatArray:
        """Compute what sensors and device add once a flight has learned from a number of recordings.

        Parameters
        ----------
        recordings : float

        Returns
        -------
        ndarray, shape (n, 6, 6), in m and rad
        """
        unit = np.eye(len(self.deviations))
        left = np.linalg.solve(unit + recordings * self.deviations @ self.information, self.deviations)
        out: FloatArray = self.sensitivity @ left @ np.swapaxes(self.sensitivity, 1, 2)
        return out

    def compute_covariances(self, recordings: float = 0.0) -> FloatArray:
        """Compute the covariances of poses once a flight has learned from a number of recordings.

        Parameters
        ----------
        recordings : float

        Returns
        -------
        ndarray, shape (n, 6, 6), in m and rad
        """
        return self.noise + self.compute_sensor_part(recordings)


MEAN_OVER_RMS = float(np.sqrt(8.0 / (3.0 * np.pi)))
"""Mean over rms length of an isotropic Gaussian vector in space."""


def compute_mean_distance(covariances: FloatArray) -> float:
    """Compute the mean distance in space between pose and truth.

    Parameters
    ----------
    covariances : ndarray, shape (n, 6, 6), in m and rad

    Returns
    -------
    float, in m
        Averaged over the poses.
    """
    return float(MEAN_OVER_RMS * np.mean(np.sqrt(np.trace(covariances[:, :3, :3], axis1=1, axis2=2))))


def _expect_deviations(mission: MissionBase) -> FloatArray:
    """Return the covariance of the deviations of sensors and device, by their tolerances or else the rig's mismatch."""
    rig, device = mission.rig, mission.robot.device
    n, off = len(rig.sensors), rig.mismatch
    sensors, tolerances = rig.sensor_covariance, np.array(mission.robot.device_tolerances)
    if sensors is None:
        one = np.array([off.sensor_gain, off.sensor_axis, off.sensor_axis, *[off.sensor_place] * 3])
        calibrated = rig.sections.sensors.calibrated is not None  # its file states no correlations: taken as exact
        sensors = np.diag(np.tile(0.0 * one if calibrated else off.scale * one, n) ** 2)
    if not tolerances.any():
        tolerances = off.scale * np.array([off.moment, off.l0 * device.l0])
    out = np.zeros((len(sensors) + DEVIATIONS_OF_DEVICE, len(sensors) + DEVIATIONS_OF_DEVICE))
    out[: len(sensors), : len(sensors)] = sensors
    out[len(sensors) :, len(sensors) :] = np.diag(tolerances**2)
    return out


def compute_horizontal_rms(covariances: FloatArray) -> FloatArray:
    """Compute the horizontal rms error of poses.

    Parameters
    ----------
    covariances : ndarray, shape (n, 6, 6), in m and rad

    Returns
    -------
    ndarray, shape (n,), in m
    """
    errors: FloatArray = np.sqrt(covariances[:, 0, 0] + covariances[:, 1, 1])
    return errors
