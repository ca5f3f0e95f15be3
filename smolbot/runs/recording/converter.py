"""Store samples as a converter's counts: exact, and a quarter of the size."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smolbot.config.sensors import SensorsSection
from smolbot.core.arrays import FloatArray

FIELD, TESLA, VOLTS, BOTH = 0, 1, 2, 3
"""Scalings: how counts become a field; see ``run.proto``."""

Counts = NDArray[np.int16]

_BLOCK = 2048  # samples of every sensor at a time


@dataclass(frozen=True, eq=False)
class Converter:
    """The analog-to-digital converter that turned fields into counts.

    Attributes
    ----------
    bits : int
    range : float, in V
        To either side of zero.
    volts_per_tesla : float, in V/T
        Of the sensors.
    gains : ndarray, shape (n_sensors,)
        Assumed relative gains; readings were divided by them.
    """

    bits: int
    range: float
    volts_per_tesla: float
    gains: FloatArray

    @classmethod
    def of(cls, section: SensorsSection, gains: FloatArray) -> Converter:
        """Build the converter of a rig file's ``[sensors]`` section.

        Parameters
        ----------
        section : SensorsSection
        gains : ndarray, shape (n_sensors,)
            Assumed relative gains.

        Returns
        -------
        Converter
        """
        return cls(section.adc_bits, section.adc_range_v, section.volts_per_tesla, np.asarray(gains, float))

    def counts(self, field: FloatArray) -> tuple[int, Counts | None]:
        """Find the scaling by which a field is a whole number of counts, and these counts.

        The counts decode to `field` bit for bit: that is how the scaling is found.

        Parameters
        ----------
        field : ndarray, shape (n_sensors, n), in T

        Returns
        -------
        int
            The scaling; ``FIELD`` if there is none.
        ndarray of int16, shape (n_sensors, n), or None
        """
        if self.bits > 16 or len(field) != len(self.gains) or not field.size:
            return FIELD, None
        counts = np.empty(field.shape, np.int16)
        for part, into in zip(_split_blocks(field), _split_blocks(counts), strict=True):
            with np.errstate(invalid="ignore"):
                rounded = np.rint(part * self.gains[:, None] / self._tesla)
            if not _is_int16(rounded):
                return FIELD, None
            into[:] = rounded
        for scaling in (TESLA, VOLTS, BOTH):
            pairs = zip(_split_blocks(counts), _split_blocks(field), strict=True)
            if all(_has_same_bits(self.field(scaling, counted), part) for counted, part in pairs):
                return scaling, counts
        return FIELD, None

    def field(self, scaling: int, counts: Counts) -> FloatArray:
        """Convert counts to a field.

        Parameters
        ----------
        scaling : int
        counts : ndarray of int16, shape (n_sensors, n)

        Returns
        -------
        ndarray, shape (n_sensors, n), in T
        """
        return self._scalings[scaling](counts.astype(float))

    @cached_property
    def _tesla(self) -> float:
        return 2.0 * (self.range / self.volts_per_tesla) / 2.0**self.bits

    @cached_property
    def _scalings(self) -> dict[int, Callable[[FloatArray], FloatArray]]:
        gains, per_tesla, tesla = self.gains[:, None], self.volts_per_tesla, self._tesla
        volts = 2.0 * self.range / 2.0**self.bits
        return {
            TESLA: lambda counts: counts * tesla / gains,
            VOLTS: lambda counts: counts * volts / per_tesla / gains,
            BOTH: lambda counts: counts * tesla * per_tesla / per_tesla / gains,
        }


def _split_blocks(values: NDArray[Any]) -> Iterator[NDArray[Any]]:
    """Yield views of some columns at a time, small enough for the processor's cache."""
    return (values[:, start : start + _BLOCK] for start in range(0, values.shape[1], _BLOCK))


def _is_int16(counts: FloatArray) -> bool:
    """Return whether all numbers fit into 16 bits; nan and infinity do not."""
    return bool(counts.min() >= -(2.0**15) and counts.max() <= 2.0**15 - 1)


def _has_same_bits(a: FloatArray, b: FloatArray) -> bool:
    """Return whether two arrays are equal bit for bit; a zero has a sign."""
    return np.array_equal(a.view(np.int64), np.ascontiguousarray(b).view(np.int64))
