"""By how much a rig may differ from what its files say: what a simulated tank draws, and a preview too."""

from __future__ import annotations

import numpy as np

from smolbot.config.document import FileModel
from smolbot.config.units import SI, NotNegative
from smolbot.core.arrays import FloatArray

MAX_SIGMAS = 3.0
"""Standard deviations to which mismatches are clipped: no lab builds a coil 2 mm away."""

MIN_FACTOR = 0.05
"""Least factor on a value: it must stay positive."""


class MismatchSection(FileModel):
    """Section ``[tank.mismatch]``: standard deviations of what is drawn; samples are clipped to three of them.

    `scale` multiplies all of them.
    """

    scale: NotNegative = 1.0
    coil_place_mm: NotNegative = 0.3
    coil_axis_deg: NotNegative = 0.5
    coil_gain_percent: NotNegative = 2.0
    time_constant_percent: NotNegative = 5.0
    drag_percent: NotNegative = 5.0
    rotation_drag_percent: NotNegative = 5.0
    drag_anisotropy_percent: NotNegative = 5.0
    density_percent: NotNegative = 1.0
    moment_percent: NotNegative = 2.0
    l0_percent: NotNegative = 3.0
    theta_max_percent: NotNegative = 3.0
    damping_percent: NotNegative = 5.0
    frequency_percent: NotNegative = 0.1
    sensor_place_mm: NotNegative = 0.2
    sensor_gain_percent: NotNegative = 0.5
    sensor_axis_deg: NotNegative = 0.3
    noise_percent: NotNegative = 10.0
    mains_frequency_percent: NotNegative = 0.02

    coil_place, coil_axis, coil_gain = SI("coil_place_mm"), SI("coil_axis_deg"), SI("coil_gain_percent")
    time_constant, drag = SI("time_constant_percent"), SI("drag_percent")
    rotation_drag, drag_anisotropy = SI("rotation_drag_percent"), SI("drag_anisotropy_percent")
    density, moment, l0 = SI("density_percent"), SI("moment_percent"), SI("l0_percent")
    theta_max, damping, frequency = SI("theta_max_percent"), SI("damping_percent"), SI("frequency_percent")
    sensor_place, sensor_gain, sensor_axis = SI("sensor_place_mm"), SI("sensor_gain_percent"), SI("sensor_axis_deg")
    noise, mains_frequency = SI("noise_percent"), SI("mains_frequency_percent")


class MismatchSampler:
    """Samples mismatches about nominal values.

    The scale multiplies the samples and changes nothing else. No sample lies beyond `MAX_SIGMAS` standard deviations.

    Parameters
    ----------
    rng : numpy.random.Generator
    scale : float
        Factor on every standard deviation; 0 gives the nominal values.
    """

    def __init__(self, rng: np.random.Generator, scale: float) -> None:
        self._rng = rng
        self._scale = scale

    def sample_offsets(self, deviation: float, *shape: int) -> FloatArray:
        """Sample offsets from zero.

        Parameters
        ----------
        deviation : float
            Standard deviation, in any unit.
        *shape : int
            Shape of the result.

        Returns
        -------
        ndarray, shape `shape`, in the unit of `deviation`
        """
        return self._scale * deviation * np.clip(self._rng.standard_normal(shape), -MAX_SIGMAS, MAX_SIGMAS)

    def sample_factors(self, deviation: float, *shape: int) -> FloatArray:
        """Sample factors about 1, none below 0.05.

        Parameters
        ----------
        deviation : float
            Standard deviation, as a fraction.
        *shape : int
            Shape of the result.

        Returns
        -------
        ndarray, shape `shape`
        """
        return np.maximum(1.0 + self.sample_offsets(deviation, *shape), MIN_FACTOR)

    def sample_factor(self, deviation: float) -> float:
        """Sample a single factor about 1.

        Parameters
        ----------
        deviation : float
            Standard deviation, as a fraction.

        Returns
        -------
        float
        """
        return float(self.sample_factors(deviation, 1)[0])
