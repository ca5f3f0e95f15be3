"""Magnetic noise of a room as a few numbers, and the noise models that follow from them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from smolbot.core.sensing import SensorArray
from smolbot.localization.noise.model import N_FREQUENCIES, NoiseModel, compute_field_covariance
from smolbot.localization.noise.spectra import ComplexArray


@dataclass(frozen=True)
class NoiseLevels:
    """Magnetic noise as a few numbers. SI units.

    Attributes
    ----------
    floor : float, in T/sqrt(Hz)
        White part of each sensor.
    at_1hz : float, in T/sqrt(Hz)
        Sensor noise at 1 Hz; falls as 1/f in power to the floor.
    mains_frequency : float, in Hz
    mains : float, in T
        Peak of the uniform part at the mains frequency.
    mains_gradient : float, in T/m
        Peak of its change per metre, root mean square over directions.
    harmonics : mapping of int to float
        Order, and size relative to the first.
    """

    floor: float
    at_1hz: float
    mains_frequency: float
    mains: float
    mains_gradient: float
    harmonics: dict[int, float] = field(default_factory=dict)

    def make_model(self, sensors: SensorArray, top: float = 5000.0) -> NoiseModel:
        """Make the noise model of an average room, with lines equally likely from all directions.

        Parameters
        ----------
        sensors : SensorArray
        top : float, in Hz
            Highest frequency of the model.

        Returns
        -------
        NoiseModel
        """
        orders = np.array([1, *self.harmonics])
        sizes = np.array([1.0, *self.harmonics.values()])
        frequencies = np.concatenate([[0.0], np.geomspace(1.0, top, N_FREQUENCIES)])
        density = self.floor**2 + max(self.at_1hz**2 - self.floor**2, 0.0) / np.maximum(frequencies, 1.0)
        lines = self.mains_frequency * orders
        space = compute_field_covariance(sensors, self.mains, self.mains_gradient).astype(np.complex128)
        power = sizes**2 / (1.0 + (lines / sensors.bandwidth) ** 2)
        return NoiseModel(
            line_frequencies=lines,
            lines=power[:, None, None] * space,
            frequencies=frequencies,
            spectrum=(density / (1.0 + (frequencies / sensors.bandwidth) ** 2))[:, None, None] * np.eye(len(sensors)),
            block=0.0,
        )

    def sample_lines(self, sensors: SensorArray, rng: np.random.Generator) -> ComplexArray:
        """Sample the mains lines of one room: random directions, gradients and phases.

        Parameters
        ----------
        sensors : SensorArray
        rng : numpy.random.Generator

        Returns
        -------
        ndarray of complex, shape (n_lines, n_sensors), in T
            Peak phasors.
        """
        orders = np.array([1, *self.harmonics])
        sizes = np.array([1.0, *self.harmonics.values()])
        out = np.empty((len(orders), len(sensors)), dtype=np.complex128)
        for k, size in enumerate(sizes / (1.0 + 1j * orders * self.mains_frequency / sensors.bandwidth)):
            direction = rng.standard_normal(3)
            direction *= self.mains / np.linalg.norm(direction)
            gradient = rng.standard_normal((3, 3))
            gradient = gradient + gradient.T
            gradient -= np.eye(3) * np.trace(gradient) / 3.0
            gradient *= np.sqrt(3.0) * self.mains_gradient / np.linalg.norm(gradient)
            first, second = np.exp(2j * np.pi * rng.random(2))
            fields = first * direction + second * (sensors.positions @ gradient)
            out[k] = size * np.einsum("ij,ij->i", sensors.responses, fields)
        return out

    def sample_room_model(self, sensors: SensorArray, seed: int, top: float = 5000.0) -> NoiseModel:
        """Sample one room, and make its noise model as if it had been learned perfectly.

        Parameters
        ----------
        sensors : SensorArray
        seed : int
        top : float, in Hz
            Highest frequency of the model.

        Returns
        -------
        NoiseModel
        """
        lines = self.sample_lines(sensors, np.random.default_rng(seed))
        return replace(self.make_model(sensors, top), lines=lines[:, :, None] * lines[:, None, :].conj())
