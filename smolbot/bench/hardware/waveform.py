"""Waveforms of shots for the card: volts for each output, relay lines, and the samples to keep."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smolbot.bench.hardware.wiring import BenchSection
from smolbot.core.arrays import FloatArray
from smolbot.core.shots import Actuate, Excite, Listen, MoveMagnet, Rotate, Shot, Window
from smolbot.errors import InputError, InterlockError

RELAY_MARGIN = 0.5e-3
"""Seconds after its opening time within which a relay must be open."""


@dataclass(frozen=True, eq=False)
class Waveform:
    """One shot on the card's clocks, which all begin with the first input sample.

    Attributes
    ----------
    volts : ndarray, shape (n_outputs, n), in V
        In the order of `BenchSection.used_outputs`; the last sample is zero. No samples if nothing is driven.
    lines : ndarray of uint32, shape (n,)
        Bit k is line k of the clocked port; set while a relay is closed or the amplifiers are enabled.
    lead : float, in s
        From the first sample to the start of the shot; relays close within it.
    samples : int
        Input samples of each sensor, from the first one to the end of the shot.
    listen : tuple of (int, int) or None
        First input sample to keep, and number of samples.
    drive_end : float or None, in s
        End of the last excitation before listening, from the first sample on.
    settled : int
        Input samples after which every relay has opened; 0 if nothing is driven.
    """

    volts: FloatArray
    lines: NDArray[np.uint32]
    lead: float
    samples: int
    listen: tuple[int, int] | None
    drive_end: float | None
    settled: int = 0

    @property
    def outputs(self) -> int:
        """Number of samples of each output."""
        return self.volts.shape[1]


@dataclass(frozen=True)
class _Drive:
    """One load driven from `start` to `end` s of the shot, with a constant current or the peak of a sine."""

    load: int
    start: float
    end: float
    current: float
    frequency: float


class WaveformCompiler:
    """Converts electrical shots to waveforms for one bench.

    A relay is switched early enough to have settled when its load's window begins: before the shot or, if
    another load used the same output until then, as soon as the relay of that load has opened. The output stays at
    zero meanwhile. At most the time in which one relay opens and another closes is lost from the window, which
    keeps its place.

    Parameters
    ----------
    section : BenchSection
    coils : tuple of str
        Actuation coils in the order of every current vector.
    input_rate : float, in Hz
        Of each sensor.
    time_constants : dict of float, in s, optional
        Time constant of each coil by its name (``+x``, ``excitation x``). A sine is amplified to make up for the
        coil's lag, so that the current has the requested peak.
    """

    def __init__(
        self,
        section: BenchSection,
        coils: tuple[str, ...],
        input_rate: float,
        time_constants: dict[str, float] | None = None,
    ) -> None:
        names = [load.name for load in section.loads]
        self._coils = [names.index(name) for name in coils]
        self._excitation = [names.index(n) for n in ("excitation x", "excitation y") if n in names]
        outputs = section.used_outputs
        self._output = [outputs.index(load.output) for load in section.loads]
        self._gain = [load.gain_a_per_v for load in section.loads]
        self._relay = [get_line_bit(load.relay) for load in section.loads]
        self._constants = [(time_constants or {}).get(name, 0.0) for name in names]
        self._names, self._enable = names, get_line_bit(section.outputs.enable)
        self._close, self._open = section.relays.closing, section.relays.opening
        self._range, self._n_outputs = section.outputs.range_v, len(outputs)
        self.output_rate, self.input_rate = section.outputs.rate_hz, input_rate

    def compile(self, shot: Shot) -> Waveform:
        """Convert a shot to a waveform.

        Parameters
        ----------
        shot : Shot

        Returns
        -------
        Waveform

        Raises
        ------
        InterlockError
            For a current beyond an output's range.
        InputError
            For a mechanical window.
        """
        drives = [drive for at, window in shot.timed() for drive in self._list_drives(at, window)]
        lead = self._close if drives else 0.0
        volts, lines = self._lay_out(drives, lead)
        listen, drive_end = None, None
        for at, window in shot.timed():
            if isinstance(window, Excite) and listen is None:
                drive_end = self._round_to_output_clock(lead + at + window.duration)
            elif isinstance(window, Listen):
                first = math.ceil((lead + at) * self.input_rate - 1e-6)
                listen = first, round(window.duration * self.input_rate)
        samples = math.ceil((lead + shot.duration) * self.input_rate - 1e-6)
        settled = 0
        if drives:  # the inputs run until every relay has opened, so that this can be looked at
            settled = math.ceil((volts.shape[1] / self.output_rate + self._open + RELAY_MARGIN) * self.input_rate)
            samples = max(samples, settled)
        if listen is not None:
            samples = max(samples, sum(listen))
        return Waveform(volts, lines, lead, max(samples, 2), listen, drive_end, settled)

    def _list_drives(self, at: float, window: Window) -> Iterator[_Drive]:
        end = at + window.duration
        if isinstance(window, Actuate):
            for load, current in zip(self._coils, window.currents, strict=True):
                if current:
                    yield _Drive(load, at, end, current, 0.0)
        elif isinstance(window, Excite):
            for load, current in zip(self._excitation, window.currents, strict=False):
                if current:
                    yield _Drive(load, at, end, current, window.frequency)
        elif isinstance(window, Rotate | MoveMagnet):
            raise InputError(f"A card cannot play {type(window).__name__}; it belongs to the magnet stage.")

    def _lay_out(self, drives: list[_Drive], lead: float) -> tuple[FloatArray, NDArray[np.uint32]]:
        if not drives:
            return np.zeros((self._n_outputs, 0)), np.zeros(0, np.uint32)
        count = (
            self._find_sample(lead + max(d.end for d in drives)) + 2
        )  # the last ones at zero, whatever rounding does
        volts, lines = np.zeros((self._n_outputs, count)), np.zeros(count, np.uint32)
        free = dict.fromkeys(range(self._n_outputs), 0.0)  # when each output's last relay has opened
        owner: dict[int, int] = {}
        for drive in drives:
            output = self._output[drive.load]
            switched = lead + drive.start - self._close
            if owner.get(output, drive.load) != drive.load:
                switched = max(switched, free[output])
            ready = self._find_sample(max(switched + self._close, lead + drive.start))
            first, end = self._find_sample(max(switched, 0.0)), self._find_sample(lead + drive.end)
            lines[first:end] |= np.uint32(1 << self._relay[drive.load] | 1 << self._enable)
            volts[output, ready:end] = self._compute_wave(drive, lead, ready, end)
            owner[output], free[output] = drive.load, lead + drive.end + self._open
        return volts, lines

    def _compute_wave(self, drive: _Drive, lead: float, first: int, end: int) -> FloatArray:
        lag = 2 * math.pi * drive.frequency * self._constants[drive.load]
        level = drive.current / self._gain[drive.load] * math.sqrt(1.0 + lag**2)
        if abs(level) > self._range * (1 + 1e-9):
            raise InterlockError(
                f"{self._names[drive.load]}: {drive.current:.2f} A needs {level:.2f} V; the output gives "
                f"±{self._range:g} V. Nothing was played.",
                limit=self._range, value=abs(level), unit="V", channel=self._names[drive.load],
            )  # fmt: skip
        if not drive.frequency:
            return np.full(max(end - first, 0), level)
        time = np.arange(first, end) / self.output_rate - (lead + drive.start)
        return np.asarray(level * np.sin(2 * np.pi * drive.frequency * time))

    def _find_sample(self, time: float) -> int:
        return round(time * self.output_rate)

    def _round_to_output_clock(self, time: float) -> float:
        return self._find_sample(time) / self.output_rate


def get_line_bit(name: str) -> int:
    """Return the number of a line within its port.

    Parameters
    ----------
    name : str

    Returns
    -------
    int

    Examples
    --------
    >>> get_line_bit("port0/line6")
    6
    """
    return int(name.rsplit("line", 1)[1])
