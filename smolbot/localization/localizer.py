"""From one recording to one pose."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Literal

import numpy as np

from smolbot.arrays import FloatArray
from smolbot.errors import InputError
from smolbot.localization import kernels
from smolbot.localization.chain import whole_half_periods
from smolbot.localization.cold_start import SearchVolume, best_start
from smolbot.localization.problem import Fit, Problem, prepare
from smolbot.poses import Pose
from smolbot.rotations import quaternion_from_matrix, rotation_error
from smolbot.sensing import Device, Recording, SensorArray

MIN_R_SQUARED = 0.7
"""Below this a fit explains too little of the signal to act on."""

MIN_AMPLITUDE = 0.05
"""Share of the stop below which a swing is no better than the mains line next to it."""


class Localizer:
    """Fits the six degrees of freedom of a SMOL device to a recording.

    Phase and amplitude are fitted along with the pose: the amplitude at the end of the drive is at
    most `Device.theta_max`, but not known.

    Parameters
    ----------
    sensors : SensorArray
    device : Device
        As it is believed to be; replaced, not changed, when it is learned anew.
    estimator : {"paper"}
        ``paper``: the paper's chain with an unweighted Levenberg-Marquardt fit (Eqs. S2 to S8, S20 to S23).
    volume : SearchVolume
        Where a cold start looks, and where a trusted pose may lie.

    Notes
    -----
    `locate` depends on its arguments alone, so that a replay is exact. Adding a constant to a
    channel does not change a pose.
    """

    def __init__(
        self,
        sensors: SensorArray,
        device: Device,
        estimator: Literal["paper"] = "paper",
        volume: SearchVolume | None = None,
    ) -> None:
        if estimator != "paper":
            raise InputError(f"estimator must be 'paper'; got {estimator!r}.")
        self.sensors = sensors
        self.device = device
        self.estimator = estimator
        self.volume = volume or SearchVolume()

    def locate(self, recording: Recording, prior: Pose | None = None) -> Pose:
        """Pose at the middle of the recording, from all of it.

        Parameters
        ----------
        recording : Recording
        prior : Pose, optional
            Start of the fit, and what decides between poses that no sensor can tell apart. Its
            covariance is not used: fusing is the tracker's work. Without it the fit starts cold.

        Returns
        -------
        Pose
            `trusted` is false where the fit explains too little, or ends outside the search volume.

        Raises
        ------
        InputError
            If the recording does not fit the sensors, or holds no half-period; says which channel.
        """
        problem = prepare(recording, self.sensors, self.device)
        if prior is None:
            best = best_start(problem, self.volume)
        else:
            best = self._from_prior(problem, np.asarray(prior.position), prior.rotation)
        return self._pose(problem, best, recording, prior)

    def locate_segments(self, recording: Recording, half_periods: int) -> tuple[Pose, ...]:
        """Poses of consecutive segments of `half_periods` each (superfast mode); the rest is left out."""
        n = recording.field.shape[1]
        total = whole_half_periods(n, recording.sample_rate, self.device.frequency)
        if not 1 <= half_periods <= total:
            raise InputError(
                f"half_periods must lie within 1 to {total}, what the recording holds; got {half_periods}."
            )
        edges = [
            min(n, round(i * half_periods * recording.sample_rate / (2.0 * self.device.frequency)))
            for i in range(total // half_periods + 1)
        ]
        poses: list[Pose] = []
        for first, last in pairwise(edges):
            offset = first / recording.sample_rate
            segment = replace(
                recording,
                field=recording.field[:, first:last],
                time_since_drive=recording.time_since_drive + offset,
                clock=recording.clock + offset,
            )
            trusted = [p for p in poses if p.trusted]
            poses.append(self.locate(segment, trusted[-1] if trusted else None))
        return tuple(poses)

    def _from_prior(self, problem: Problem, position: FloatArray, rotation: FloatArray) -> Fit:
        """Fit from a known pose; phase and amplitude start from a linear solve at that pose."""
        phase, amplitude = problem.phase_and_amplitude(position, rotation)
        tries = [problem.fit(position, rotation, phase, amplitude)]
        if tries[0].sse > 0.3 * problem.total_sum_of_squares:
            tries.append(best_start(problem, self.volume))
        return min(tries, key=lambda t: t.sse)

    def _pose(self, problem: Problem, best: Fit, recording: Recording, prior: Pose | None) -> Pose:
        flip_margin = 1.0
        if not self.device.along_cantilever:
            best, flip_margin = self._settle_flip(problem, best)
        orientation = quaternion_from_matrix(best.rotation)
        if self.device.along_cantilever:
            orientation = _nearer(orientation, prior)
        n_data = problem.data.size
        variance = best.sse / max(n_data - 8, 1)
        r_squared = 1.0 - best.sse / problem.total_sum_of_squares if problem.total_sum_of_squares > 0 else 0.0
        covariance = kernels.covariance(best.normal, variance)
        inside = all(
            low - 0.02 <= p <= high + 0.02
            for low, p, high in zip(self.volume.low, best.position, self.volume.high, strict=True)
        )
        usable = bool(np.isfinite(covariance[0, 0])) and best.amplitude > MIN_AMPLITUDE * problem.model.amplitude_max
        return Pose(
            time=recording.middle,
            position=best.position,
            orientation=orientation,
            covariance=covariance if usable else np.diag([1e-2] * 3 + [10.0] * 3),
            r_squared=float(r_squared),
            flip_margin=flip_margin,
            trusted=bool(best.converged and inside and usable and r_squared >= MIN_R_SQUARED),
        )

    def _settle_flip(self, problem: Problem, best: Fit) -> tuple[Fit, float]:
        """Fit the other member of the two-fold ambiguity as well; keep the better, return their ratio."""
        moment = best.rotation @ self.device.moment_in_body
        half_turn = 2.0 * np.outer(moment, moment) - np.eye(3)
        turned = half_turn @ best.rotation
        position = best.position + self.device.l0 * (best.rotation[:, 2] - turned[:, 2])
        other = problem.fit(position, turned, best.phase + np.pi, best.amplitude)
        low, high = sorted((best, other), key=lambda t: t.sse)
        same = np.linalg.norm(
            rotation_error(quaternion_from_matrix(low.rotation), quaternion_from_matrix(high.rotation))
        )
        if same < 0.1:
            return low, 1e6
        return low, float(max(1.0, np.sqrt(high.sse / max(low.sse, 1e-300))))


def _nearer(orientation: FloatArray, prior: Pose | None) -> FloatArray:
    """Of the two orientations that sound the same when the moment lies along the cantilever, the nearer one."""
    if prior is None:
        return orientation
    w, x, y, z = orientation
    other = np.array([-z, y, -x, w])  # turned by 180 degrees about body z
    return orientation if abs(orientation @ prior.orientation) >= abs(other @ prior.orientation) else other
