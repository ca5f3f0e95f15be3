"""A search for sensor positions: the bound of `smolbot.localization.bounds`, arranged so that one sensor can move."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sim.studies.layout_value import AXES, HALF_WIDTH, MIN_DISTANCE, Mismatch, Poses, find_side_axes
from smolbot.core.arrays import FloatArray
from smolbot.core.sensing import Device, SensorArray
from smolbot.localization import basis as time_functions
from smolbot.localization.bounds import ListeningWindow, compute_channel_series
from smolbot.localization.noise.room import NoiseLevels
from smolbot.localization.noise.whitening import make_block_taps

IntArray = npt.NDArray[np.int64]

BLOCK = 0.8e-3
"""Length of a block, in s, longer than the estimator's: a search needs the order of layouts only."""

N_PHASES = 2
"""Phases of the oscillation, over half a turn, across which a layout is evaluated."""

TOP_FREQUENCY = 2500.0
"""Highest frequency of the sensors' noise, in Hz."""

START_HALF_WIDTH = 0.065
"""Of a random layout, in m."""

GRID_DIGITS, ROUNDING = 3, 1e-9
"""Decimals, in m, to which positions are rounded, and slack of a distance."""

TURN_AXIS, SWAP_AXES, JUMP = 0.15, 0.25, 0.4
"""Cumulative probabilities of a new axis, of two axes swapped, and of a new position; otherwise a sensor is shifted."""

SHIFTS = [0.025, 0.008, 0.0025]
"""Standard deviations of a shift, in m."""

PROGRESS = 0.999
"""Ratio of scores below which a descent has made progress."""


@dataclass(frozen=True, eq=False)
class Share:
    """Contribution of one sensor to the information, for each device, phase and pose.

    Attributes
    ----------
    information : ndarray, shape (n_waveforms, n_poses, 8, 8)
    lines : ndarray, shape (n_waveforms, n_poses, 2 n_lines, 8)
        Unknowns against cosine and sine of each line.
    crossed : ndarray, shape (n_waveforms, n_poses, 8, 6)
        Unknowns against the sensor's own errors.
    line_errors : ndarray, shape (n_waveforms, n_poses, 2 n_lines, 6)
    """

    information: FloatArray
    lines: FloatArray
    crossed: FloatArray
    line_errors: FloatArray


@dataclass(frozen=True, eq=False)
class Layout:
    """Places (n, 2) in m in the sensor plane, and the axis of each: 0, 1, 2 for x, y, z."""

    places: FloatArray
    axes: IntArray

    def to_sensors(self, bandwidth: float) -> SensorArray:
        """Convert to a sensor array.

        Parameters
        ----------
        bandwidth : float, in Hz

        Returns
        -------
        SensorArray
        """
        return SensorArray(np.column_stack([self.places, np.zeros(len(self.places))]), AXES[self.axes], bandwidth)

    def is_allowed(self) -> bool:
        """Return whether sensors lie in the square, far enough apart, and along at least two axes.

        Returns
        -------
        bool
        """
        apart = np.linalg.norm(self.places[:, None] - self.places[None], axis=-1) + np.eye(len(self.places))
        inside = bool(np.abs(self.places).max() <= HALF_WIDTH + ROUNDING)
        return inside and bool(apart.min() >= MIN_DISTANCE - ROUNDING) and len(set(self.axes.tolist())) >= 2


class LayoutScorer:
    """Scores layouts by the rms error over poses, devices, phases and sampled directions of the mains.

    Parameters
    ----------
    devices : sequence of Device
    levels : NoiseLevels
    window : ListeningWindow
    poses : Poses
    bandwidth : float, in Hz
    mismatch : Mismatch
    weight : float
        Of systematic errors beside random ones, as variances: 0 uses the bound alone.
    draws : int
        Sampled directions and phases of the mains.
    """

    def __init__(
        self,
        devices: Sequence[Device],
        levels: NoiseLevels,
        window: ListeningWindow,
        poses: Poses,
        bandwidth: float,
        mismatch: Mismatch,
        weight: float,
        draws: int = 4,
    ) -> None:
        self.devices, self.levels, self.window, self.poses = devices, levels, window, poses
        self.bandwidth, self.mismatch, self.weight, self.draws = bandwidth, mismatch, weight, draws
        chain = make_block_taps(window.count_samples(devices[0].frequency), window.sample_rate, BLOCK)
        n_blocks, size = chain.weights.shape
        block = size / window.sample_rate
        one = SensorArray(np.zeros((1, 3)), np.eye(3)[2:], bandwidth)
        own = replace(levels, mains=0.0, mains_gradient=0.0).make_model(one, TOP_FREQUENCY).covariance(n_blocks, block)
        kept = np.linalg.qr(np.ones((n_blocks, 1)), mode="complete")[0][:, 1:]  # a constant is free
        whiten = np.linalg.inv(np.linalg.cholesky(kept.T @ own @ kept)) @ kept.T
        self._orders = np.array([1, *levels.harmonics])
        frequencies = levels.mains_frequency * self._orders
        wave = np.exp(2j * np.pi * np.outer(block * np.arange(n_blocks), frequencies)) * np.sinc(frequencies * block)
        self._waves = whiten @ np.stack([wave.real, wave.imag], axis=2).reshape(n_blocks, -1)
        self._waveforms: list[tuple[Device, FloatArray]] = []  # device, and its whitened functions (n_data, 2 K)
        self._amplitude = devices[0].theta_max / time_functions.REFERENCE_ANGLE
        for device in devices:
            basis = time_functions.compute_time_basis(device, chain, window.sample_rate, window.since, bandwidth)
            size_k = self._amplitude ** np.arange(len(basis))
            harmonics = 1j * np.arange(basis.shape[1])
            for phase in np.pi * np.arange(N_PHASES) / N_PHASES:
                turned = basis * np.exp(harmonics * phase)[None, :, None]
                now = size_k[:, None] * np.real(turned.sum(axis=1))
                ahead = size_k[:, None] * np.real((harmonics[None, :, None] * turned).sum(axis=1))
                self._waveforms.append((device, whiten @ np.concatenate([now, ahead]).T))

    def compute_share(self, place: FloatArray, axis: int) -> Share:
        """Compute the contribution of one sensor.

        Parameters
        ----------
        place : ndarray, shape (2,), in m
        axis : int

        Returns
        -------
        Share
        """
        sensor = SensorArray(np.array([[*place, 0.0]]), AXES[[axis]], self.bandwidth)
        parts: list[tuple[FloatArray, ...]] = []
        for number, (device, functions) in enumerate(self._waveforms):
            if number % N_PHASES == 0:
                columns, errors = self._compute_columns(sensor, device)
            gram, on_waves = functions.T @ functions, self._waves.T @ functions
            on_columns = gram @ columns
            parts.append((
                np.swapaxes(columns, 1, 2) @ on_columns, on_waves @ columns,
                np.swapaxes(on_columns, 1, 2) @ errors, on_waves @ errors,
            ))  # fmt: skip
        return Share(*(np.array(group) for group in zip(*parts, strict=True)))

    def _compute_columns(self, sensor: SensorArray, device: Device) -> tuple[FloatArray, FloatArray]:
        """Compute coefficients (n_poses, 2 K, ·) of the eight unknowns, and of the sensor's six errors."""
        places, turns = self.poses.positions, self.poses.rotations
        values, slopes = (a[:, 0] for a in compute_channel_series(sensor, device, places, turns))
        n_poses, n_powers = values.shape
        columns = np.zeros((n_poses, 2 * n_powers, 8))
        columns[:, :n_powers, :6] = slopes
        columns[:, n_powers:, 6] = values
        columns[:, :n_powers, 7] = values * np.arange(n_powers) / self._amplitude
        errors = np.zeros((n_poses, 2 * n_powers, 6))
        if self.weight > 0.0:
            errors[:, :n_powers, :3] = self.mismatch.place * slopes[..., :3]
            errors[:, :n_powers, 3] = self.mismatch.gain * values
            for i, side in enumerate(find_side_axes(sensor.axes)):
                tilted = compute_channel_series(replace(sensor, axes=side), device, places, turns)[0][:, 0]
                errors[:, :n_powers, 4 + i] = self.mismatch.tilt * tilted
        return columns, errors

    def compute_shares(self, layout: Layout) -> list[Share]:
        """Compute the contribution of each sensor of a layout.

        Parameters
        ----------
        layout : Layout

        Returns
        -------
        list of Share
        """
        return [self.compute_share(place, int(axis)) for place, axis in zip(layout.places, layout.axes, strict=True)]

    def find_best_of_random(self, n_sensors: int, count: int, rng: np.random.Generator) -> Layout:
        """Find the best of some random layouts: the start of a search.

        Parameters
        ----------
        n_sensors : int
        count : int
        rng : numpy.random.Generator

        Returns
        -------
        Layout
        """
        found: list[Layout] = []
        while len(found) < count:
            layout = Layout(
                np.round(rng.uniform(-START_HALF_WIDTH, START_HALF_WIDTH, (n_sensors, 2)), GRID_DIGITS),
                rng.integers(0, 3, n_sensors),
            )
            if layout.is_allowed():
                found.append(layout)
        return min(found, key=lambda one: self.compute_score(one, self.compute_shares(one)))

    def compute_score(self, layout: Layout, shares: Sequence[Share]) -> float:
        """Compute the root mean square error per axis.

        Parameters
        ----------
        layout : Layout
        shares : sequence of Share
            In the order of the layout's sensors.

        Returns
        -------
        float, in m
        """
        sensors = layout.to_sensors(self.bandwidth)
        information = np.sum([s.information for s in shares], axis=0)
        overlap = self._waves.T @ self._waves
        total = 0.0
        for draw in range(self.draws):
            phasors = self.levels.sample_lines(sensors, np.random.default_rng(draw))
            mixers = [_make_mixer(phasors[:, j]) for j in range(len(sensors))]
            # noise of the lines of the mains, by the Woodbury identity
            inside = np.linalg.inv(np.eye(len(overlap)) + sum(m @ overlap @ m.T for m in mixers))
            on_waves = np.sum([m @ s.lines for m, s in zip(mixers, shares, strict=True)], axis=0)
            left = np.swapaxes(on_waves, -1, -2) @ inside
            covariance = _invert(information - left @ on_waves)
            total += float(np.mean(np.einsum("cpaa->cp", covariance[..., :3, :3])))
            if self.weight > 0.0:
                for mixer, share in zip(mixers, shares, strict=True):
                    moved = covariance[..., :3, :] @ (share.crossed - left @ (mixer @ share.line_errors))
                    total += self.weight * float(np.mean(np.sum(moved**2, axis=(-2, -1))))
        return float(np.sqrt(total / self.draws / 3.0))


def _make_mixer(phasors: npt.NDArray[np.complex128]) -> FloatArray:
    """Make the matrix (2 L, 2 L) from one sensor's cosine and sine of each line to the lines' two quadratures."""
    out = np.zeros((2 * len(phasors), 2 * len(phasors)))
    for i, a in enumerate(phasors):
        out[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = np.array([[a.real, -a.imag], [a.imag, a.real]]) / np.sqrt(2.0)
    return out


def _invert(information: FloatArray) -> FloatArray:
    scale = 1.0 / np.sqrt(np.einsum("...ii->...i", information))
    outer = scale[..., :, None] * scale[..., None, :]
    inverse: FloatArray = np.linalg.inv(information * outer) * outer
    return inverse


class Search:
    """One descent: one sensor at a time is moved, turned or exchanged; a change is kept if it helps.

    Parameters
    ----------
    scorer : LayoutScorer
    start : Layout
    rng : numpy.random.Generator
    """

    def __init__(self, scorer: LayoutScorer, start: Layout, rng: np.random.Generator) -> None:
        self._scorer, self._rng = scorer, rng
        self.layout, self.steps = start, 0
        self.shares = scorer.compute_shares(start)
        self.score = scorer.compute_score(start, self.shares)

    def step(self) -> bool:
        """Try one change.

        Returns
        -------
        bool
            True if it was kept.
        """
        rng, places, axes = self._rng, self.layout.places.copy(), self.layout.axes.copy()
        i, kind = int(rng.integers(len(axes))), rng.random()
        changed = {i}
        if kind < TURN_AXIS:
            axes[i] = rng.integers(3)
        elif kind < SWAP_AXES:
            k = int(rng.integers(len(axes)))
            axes[[i, k]] = axes[[k, i]]
            changed.add(k)
        elif kind < JUMP:
            places[i] = rng.uniform(-HALF_WIDTH, HALF_WIDTH, 2)
        else:
            places[i] += rng.choice(SHIFTS) * rng.standard_normal(2)
        places = np.clip(np.round(places, GRID_DIGITS), -HALF_WIDTH, HALF_WIDTH)
        layout = Layout(places, axes)
        if not layout.is_allowed():
            return False
        shares = [
            self._scorer.compute_share(places[j], int(axes[j])) if j in changed else s
            for j, s in enumerate(self.shares)
        ]
        score = self._scorer.compute_score(layout, shares)
        self.steps += 1
        if score >= self.score:
            return False
        self.layout, self.shares, self.score = layout, shares, score
        return True

    def run(self, patience: int, until: Callable[[], bool] = lambda: False) -> None:
        """Step until nothing has helped for `patience` tries.

        Parameters
        ----------
        patience : int
        until : callable
            Ends the search earlier where it returns true.
        """
        idle, best = 0, self.score
        while idle < patience and not until():
            self.step()
            idle += 1
            if self.score < PROGRESS * best:
                idle, best = 0, self.score
