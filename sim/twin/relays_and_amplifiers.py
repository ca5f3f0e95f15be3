"""Relays and amplifiers between the card and the coils, sample by sample."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from smolbot.bench.hardware.waveform import get_line_bit
from smolbot.bench.hardware.wiring import BenchSection
from smolbot.core.arrays import BoolArray, FloatArray


class RelaysAndAmplifiers:
    """Computes the load currents from output voltages and line levels.

    A relay follows its line after its closing or opening time. Loads whose relays are closed on one output share
    its current. Amplifiers that are not enabled drive nothing.

    Parameters
    ----------
    section : BenchSection
    loads : tuple of str
        Names of the loads, in the order of the currents.

    Attributes
    ----------
    closed : ndarray of bool, shape (n_loads,)
        Present state of the contacts.
    stuck : int or None
        Index of a load whose contacts do not open any more.
    """

    def __init__(self, section: BenchSection, loads: tuple[str, ...]) -> None:
        names = [load.name for load in section.loads]
        order = [section.loads[names.index(name)] for name in loads]
        outputs = section.used_outputs
        self._output = np.array([outputs.index(load.output) for load in order])
        self._gain = np.array([load.gain_a_per_v for load in order])
        self._bits = np.array([get_line_bit(load.relay) for load in order])
        self._enable = get_line_bit(section.outputs.enable)
        rate = section.outputs.rate_hz
        self._close = round(section.relays.closing * rate)
        self._open = round(section.relays.opening * rate)
        self.closed: BoolArray = np.zeros(len(order), np.bool_)
        self._commanded: BoolArray = np.zeros(len(order), np.bool_)
        self._due: list[tuple[int, int, bool]] = []  # sample, load, whether it closes
        self.stuck: int | None = None

    def release_stuck(self) -> None:
        """Let stuck contacts follow their relay again."""
        if self.stuck is not None:
            self.closed[self.stuck] = self._commanded[self.stuck]
            self.stuck = None

    def compute_currents(
        self, first: int, volts: FloatArray, lines: NDArray[np.uint32]
    ) -> tuple[FloatArray, BoolArray, BoolArray]:
        """Compute currents, contacts and enable line for consecutive samples.

        Parameters
        ----------
        first : int
            Index of the first sample.
        volts : ndarray, shape (n_outputs, n), in V
        lines : ndarray of uint32, shape (n,)
            One bit per line.

        Returns
        -------
        currents : ndarray, shape (n_loads, n), in A
        contacts : ndarray of bool, shape (n_loads, n)
            Whether closed.
        enabled : ndarray of bool, shape (n,)
        """
        n = len(lines)
        commanded = (lines[None, :] >> self._bits[:, None]) & 1 > 0
        contacts = np.empty((len(self._bits), n), np.bool_)
        for load in range(len(self._bits)):
            contacts[load] = self._update_relay(load, first, commanded[load])
        if self.stuck is not None:
            contacts[self.stuck] = True
        self.closed = contacts[:, -1].copy()
        enabled = (lines >> self._enable) & 1 > 0
        shared = np.zeros((len(volts), n))
        for load, output in enumerate(self._output):
            shared[output] += contacts[load]
        currents = np.where(contacts, volts[self._output] * self._gain[:, None], 0.0)
        currents /= np.maximum(shared[self._output], 1.0)
        currents[:, ~enabled] = 0.0
        return currents, contacts, enabled

    def _update_relay(self, load: int, first: int, commanded: BoolArray) -> BoolArray:
        """Compute the contacts of one relay over the samples, given its commanded levels."""
        n = len(commanded)
        if bool(commanded[0]) != bool(self._commanded[load]) or commanded.any() != commanded.all():
            before = np.concatenate([[self._commanded[load]], commanded[:-1]])
            for at in np.flatnonzero(commanded != before):
                closes = bool(commanded[at])
                self._due.append((first + int(at) + (self._close if closes else self._open), load, closes))
            self._commanded[load] = commanded[-1]
        out = np.full(n, self.closed[load] if load != self.stuck else True)
        later = []
        for sample, which, closes in self._due:
            if which != load or sample >= first + n:
                later.append((sample, which, closes))
            else:
                out[max(sample - first, 0) :] = closes
        self._due = later
        return out
