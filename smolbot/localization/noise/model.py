"""The noise model learned from recordings of background noise: coherent lines, and a smooth spectrum between them.

Mains and other machines make lines that every sensor measures with its own size and phase; the rest is
smooth in frequency. Both are stationary, so together they give the covariance of any window.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from smolbot.core.arrays import BoolArray, FloatArray
from smolbot.errors import InputError
from smolbot.localization.noise.spectra import BLOCK_RATE, SEGMENT, ComplexArray, learn_spectra

if TYPE_CHECKING:
    from smolbot.core.sensing import Recording, SensorArray

MIN_SEGMENTS = 1.5
"""Shortest background recording, in segments of the spectrum."""

N_HARMONICS, N_FREQUENCIES = 8, 200
"""Harmonics of the mains, and frequencies of the spectrum, of an assumed noise model."""

MIN_DENSITY = 1e-3
"""Smallest noise power, as a share of the sensors' floor: keeps covariances invertible above the bandwidth."""

SAME_SPACING = 1.001
"""Factor within which the frequencies of a model already have the requested spacing."""

POINTS_PER_LINE = 8.0
"""Frequencies in one over a window's length at which the spectrum is integrated."""

GRADIENT_ISOTROPY = 0.3
"""For an isotropic, symmetric, trace-free gradient G: <G_ab G_cd> = 0.3 g² (δac δbd + δad δbc - 2/3 δab δcd)."""


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Covariance of the noise in any window.

    Attributes
    ----------
    line_frequencies : ndarray, shape (n_lines,), in Hz
    lines : ndarray of complex, shape (n_lines, n_sensors, n_sensors), in T²
        Mean of a a^H of the lines' peak phasors a.
    frequencies : ndarray, shape (n_frequencies,), in Hz
    spectrum : ndarray of complex, shape (n_frequencies, n_sensors, n_sensors), in T²/Hz
        One-sided cross-spectral density of the noise without the lines.
    block : float, in s
        Length of the blocks over which the samples of background noise were averaged.

    Examples
    --------
    >>> import numpy as np
    >>> import smolbot
    >>> rng = np.random.default_rng(1)
    >>> recordings = [smolbot.Recording(1e-9 * rng.normal(size=(3, 10000)), 10e3, np.inf) for _ in range(4)]
    >>> smolbot.NoiseModel.learn(recordings).n_sensors
    3
    """

    line_frequencies: FloatArray
    lines: ComplexArray
    frequencies: FloatArray
    spectrum: ComplexArray
    block: float

    @property
    def n_sensors(self) -> int:
        """Number of sensors."""
        return self.spectrum.shape[1]

    @classmethod
    def learn(cls, quiet: Sequence[Recording]) -> NoiseModel:
        """Learn from recordings of background noise; ten seconds in all suffice.

        A channel that is saturated or constant in all of them gives no information on its noise, and is assumed to
        be as noisy as the others and uncorrelated with them. Recordings in which another channel is saturated or
        constant are left out if any others remain.

        Parameters
        ----------
        quiet : sequence of Recording
            Of one sample rate and one set of sensors, each at least 0.3 s long.

        Returns
        -------
        NoiseModel

        Raises
        ------
        InputError
            If there is no recording, if they differ in rate or channels, are too short or have values that are not
            finite, or if no channel is usable.
        """
        if not quiet:
            raise InputError("NoiseModel.learn needs at least one background recording; got none.")
        kinds = {(r.field.shape[0], r.sample_rate) for r in quiet}
        if len(kinds) > 1:
            raise InputError(f"Background recordings must agree in channels and sample rate (Hz); got {sorted(kinds)}.")
        for number, recording in enumerate(quiet):
            if recording.duration < MIN_SEGMENTS * SEGMENT:
                least = f"at least {MIN_SEGMENTS * SEGMENT:g} s are needed."
                raise InputError(f"Background recording {number} lasts {recording.duration:.3f} s; {least}")
            lost = np.flatnonzero(~np.isfinite(recording.field.sum(axis=1)))
            if lost.size:
                raise InputError(
                    f"Background recording {number}: channel {int(lost[0])} has values that are not finite."
                )
        silent = np.array([r.saturated | (np.ptp(r.field, axis=1) == 0.0) for r in quiet])
        clean = [not np.any(each & ~silent.all(axis=0)) for each in silent]
        chosen = [r for r, good in zip(quiet, clean, strict=True) if good] or list(quiet)
        bad: BoolArray = np.asarray(silent.all(axis=0) if any(clean) else silent.any(axis=0))
        if bad.all():
            raise InputError(
                "Every channel of the background recordings is saturated or constant: nothing can be learned."
            )
        if not bad.any():
            return cls(*learn_spectra(chosen))
        alive = [replace(r, field=r.field[~bad], saturated=r.saturated[~bad]) for r in chosen]
        return cls(*learn_spectra(alive))._with_unknown_channels(bad)

    def _with_unknown_channels(self, unknown: BoolArray) -> NoiseModel:
        """Return the model of all channels, those of `unknown` with the mean noise of the others."""
        known = np.flatnonzero(~unknown)

        def wider(matrices: ComplexArray) -> ComplexArray:
            out = np.zeros((len(matrices), len(unknown), len(unknown)), dtype=np.complex128)
            out[:, known[:, None], known] = matrices
            own = np.real(np.einsum("fjj->fj", matrices)).mean(axis=1)
            out[:, unknown, unknown] = own[:, None]
            return out

        return replace(self, lines=wider(self.lines), spectrum=wider(self.spectrum))

    @classmethod
    def assumed(
        cls,
        sensors: SensorArray,
        *,
        floor: float = 6e-12,
        at_1hz: float = 20e-12,
        mains_frequency: float = 50.0,
        mains: float = 10e-9,
        mains_gradient: float = 30e-9,
    ) -> NoiseModel:
        """Make a typical model without any recording: mains of unknown direction, and the sensors' own noise.

        Parameters
        ----------
        sensors : SensorArray
        floor : float, in T/sqrt(Hz)
            White noise of each sensor.
        at_1hz : float, in T/sqrt(Hz)
            Noise of each sensor at 1 Hz.
        mains_frequency : float, in Hz
        mains : float, in T
            Peak of the uniform part at the mains frequency; harmonics up to the eighth fall off as 1/order.
        mains_gradient : float, in T/m

        Returns
        -------
        NoiseModel
        """
        n = len(sensors)
        orders = np.arange(1, N_HARMONICS + 1)
        space = compute_field_covariance(sensors, mains, mains_gradient).astype(np.complex128)
        frequencies = np.concatenate([[0.0], np.geomspace(1.0, 0.5 * BLOCK_RATE, N_FREQUENCIES)])
        density = floor**2 + max(at_1hz**2 - floor**2, 0.0) / np.maximum(frequencies, 1.0)
        if np.isfinite(sensors.bandwidth):
            density = density / (1.0 + (frequencies / sensors.bandwidth) ** 2)
        density = np.maximum(density, MIN_DENSITY * floor**2)
        return cls(
            line_frequencies=np.asarray(mains_frequency * orders, dtype=np.float64),
            lines=space[None] / orders[:, None, None] ** 2,
            frequencies=frequencies,
            spectrum=density[:, None, None] * np.eye(n, dtype=np.complex128),
            block=1.0 / BLOCK_RATE,
        )

    def rescaled(self, ratios: FloatArray) -> NoiseModel:
        """Return the model with the power of each sensor's smooth part changed; the lines stay.

        Parameters
        ----------
        ratios : ndarray, shape (n_sensors,)
            New over old power.

        Returns
        -------
        NoiseModel
        """
        by = np.sqrt(np.asarray(ratios, dtype=np.float64))
        return replace(self, spectrum=self.spectrum * np.outer(by, by))

    def save(self, path: str | Path) -> None:
        """Write to a ``.npz`` file.

        Parameters
        ----------
        path : str or Path
        """
        np.savez_compressed(
            Path(path),
            kind="smolbot noise model",
            line_frequencies=self.line_frequencies,
            lines=self.lines,
            frequencies=self.frequencies,
            spectrum=self.spectrum,
            block=self.block,
        )

    @classmethod
    def load(cls, path: str | Path) -> NoiseModel:
        """Read a file written by `save`.

        Parameters
        ----------
        path : str or Path

        Returns
        -------
        NoiseModel

        Raises
        ------
        InputError
            If the file is missing, or is no noise model.
        """
        try:
            with np.load(Path(path)) as file:
                if "kind" not in file or str(file["kind"]) != "smolbot noise model":
                    raise InputError(f"{path}: is not a noise model of smolbot.")
                return cls(
                    file["line_frequencies"], file["lines"], file["frequencies"], file["spectrum"], float(file["block"])
                )
        except (OSError, ValueError, KeyError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{path}: cannot be read as a noise model: {error}.") from error

    def _resample(self, spacing: float) -> tuple[FloatArray, ComplexArray]:
        """Resample the spectrum at most `spacing` apart, so that no lag of a window wraps round."""
        steps = np.diff(self.frequencies)
        if steps.max() <= SAME_SPACING * min(spacing, steps.min()):
            return self.frequencies, self.spectrum
        grid = np.arange(0.0, self.frequencies[-1] + 0.5 * spacing, spacing)
        place = np.interp(grid, self.frequencies, np.arange(len(self.frequencies)))
        low = np.minimum(place.astype(np.int64), len(self.frequencies) - 2)
        part = (place - low)[:, None, None]
        return grid, (1.0 - part) * self.spectrum[low] + part * self.spectrum[low + 1]

    def covariance(self, n_blocks: int, block: float) -> FloatArray:
        """Compute the covariance of averages over successive blocks.

        Parameters
        ----------
        n_blocks : int
        block : float, in s

        Returns
        -------
        ndarray, shape (n_sensors * n_blocks, n_sensors * n_blocks), in T²
            Sensor by sensor, blocks in order.
        """
        lags = block * np.arange(n_blocks)
        grid, spectrum = self._resample(1.0 / (POINTS_PER_LINE * block * n_blocks))
        # a mean over a block multiplies the spectrum by sinc²; the model's own blocks are taken out
        averaged = np.sinc(grid * block) ** 2 / np.sinc(grid * self.block) ** 2
        wave = np.exp(2j * np.pi * np.outer(lags, grid)) * (grid[1] - grid[0]) * averaged
        smooth = np.real(wave @ spectrum.reshape(len(grid), -1)).reshape(n_blocks, self.n_sensors, self.n_sensors)
        line_wave = np.exp(2j * np.pi * np.outer(lags, self.line_frequencies))
        line_size = 0.5 * np.sinc(self.line_frequencies * block) ** 2
        sharp = np.real(np.einsum("ln,njk->ljk", line_wave * line_size, self.lines))
        by_lag = smooth + sharp  # E[x_j(t + lag) x_k(t)]
        n = self.n_sensors
        out = np.zeros((n, n_blocks, n, n_blocks))
        for lag in range(n_blocks):
            later = np.arange(lag, n_blocks)
            out[:, later, :, later - lag] = by_lag[lag]
            out[:, later - lag, :, later] = by_lag[lag].T
        return out.reshape(n * n_blocks, n * n_blocks)


def compute_field_covariance(sensors: SensorArray, uniform: float, gradient: float) -> FloatArray:
    """Compute the covariance between sensors of a field with random direction and gradient: the mean of b b^T.

    The gradient G is symmetric and free of trace, <G_ab G_cd> = 0.3 g² (d_ac d_bd + d_ad d_bc - 2/3 d_ab d_cd).

    Parameters
    ----------
    sensors : SensorArray
    uniform : float, in T
        Size of the uniform part.
    gradient : float, in T/m
        Change per metre, g, root mean square over directions.

    Returns
    -------
    ndarray, shape (n_sensors, n_sensors), in T²
    """
    place, axes = sensors.positions, sensors.axes
    alignment = axes @ axes.T
    crossed = (axes @ place.T) * (axes @ place.T).T
    own = np.einsum("ja,ja->j", axes, place)
    changing = alignment * (place @ place.T) + crossed - 2.0 / 3.0 * np.outer(own, own)
    total: FloatArray = uniform**2 / 3.0 * alignment + GRADIENT_ISOTROPY * gradient**2 * changing
    return total
