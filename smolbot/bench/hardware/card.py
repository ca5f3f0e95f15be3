"""The data acquisition card: its tasks, which are made once, and the shots that are played with them."""

from __future__ import annotations

import contextlib
import functools
import itertools
import threading
import time
from collections.abc import Iterator
from typing import Any, Protocol

import numpy as np

from smolbot.bench.hardware.driver import Driver
from smolbot.bench.hardware.waveform import Waveform
from smolbot.bench.hardware.wiring import BenchSection
from smolbot.core.arrays import FloatArray
from smolbot.errors import RigError

READ_TIMEOUT = 0.06
"""Seconds that samples may be late before their window counts as lost; outputs go on meanwhile."""

TEST_SAMPLES = 100
"""Number of samples of a recording that only tests the inputs."""

MAX_READ_DURATION = 0.03
"""Seconds of samples in one read: a stop takes effect within it, and no message grows large."""


LAST_READ_DURATION = 4e-3
"""Seconds of samples in the last read, for which the loop waits."""


class LostWindow(Exception):  # noqa: N818 - no error of the program's: a window that can be done without
    """A listening window was lost; the outputs are at zero, and the card is ready for the next shot."""


class OutputGuard(Protocol):
    """Protocol of the watchdog that protects whatever is driven."""

    def arm(self) -> None:
        """Start the watchdog, before something is driven."""

    def disarm(self) -> None:
        """Stop the watchdog, once nothing is driven any more."""

    def abandon(self) -> None:
        """Let the watchdog expire, since something may still be driven."""

    def check_relays_open(self) -> None:
        """Raise `RigError` unless every relay is open."""


class Card:
    """Plays waveforms on the card. Every task is made once; a shot only fills and starts them.

    Parameters
    ----------
    section : BenchSection
    sample_rate : float, in Hz
        Of each input.
    driver : Driver
        The client library, on this machine's driver or on a device server.

    Attributes
    ----------
    product : str
        Product type that the driver reports.
    serial : str
        Serial number, hexadecimal.

    Raises
    ------
    RigError
        If the card is missing, is another product, or a channel is not available; nothing was energised.
    """

    def __init__(self, section: BenchSection, sample_rate: float, driver: Driver) -> None:
        self._section, self._rate, self._driver = section, sample_rate, driver
        self.product, self.serial = "", ""
        self._stopped = threading.Event()
        self._lengths: dict[str, int] = {}
        self._call_timeout = section.call_timeout
        self._tasks: list[Any] = []
        try:
            with self._translate_errors("open"):
                self._open()
        except BaseException:
            self.close()
            raise

    def _open(self) -> None:
        from nidaqmx.constants import LineGrouping, TerminalConfiguration
        from nidaqmx.stream_readers import AnalogMultiChannelReader
        from nidaqmx.stream_writers import AnalogMultiChannelWriter, DigitalSingleChannelWriter

        section, name = self._section, self._section.device
        device = self._driver.get_device(name)
        self.product, self.serial = device.product_type, f"{device.serial_num:08X}"
        if self.product != section.product:
            raise RigError(
                f"{name} is a {self.product}; the rig file's bench.product says {section.product}.", device=name
            )
        device.reset_device()  # whatever another program left: outputs at zero, lines low, watchdog off
        self.inputs = self._make_task()
        terminal = {
            "differential": TerminalConfiguration.DIFF,
            "rse": TerminalConfiguration.RSE,
            "nrse": TerminalConfiguration.NRSE,
        }[section.inputs.terminal]
        span = section.inputs.range_v
        channels = ", ".join(f"{name}/{channel}" for channel in section.inputs.channels)
        self.inputs.ai_channels.add_ai_voltage_chan(channels, terminal_config=terminal, min_val=-span, max_val=span)
        outputs, top = ", ".join(f"{name}/{channel}" for channel in section.used_outputs), section.outputs.range_v
        lines = ", ".join(f"{name}/{line}" for line in section.clocked_lines)
        self.outputs, self.lines, self._zero_outputs, self._zero_lines = (self._make_task() for _ in range(4))
        for task in (self.outputs, self._zero_outputs):
            task.ao_channels.add_ao_voltage_chan(outputs, min_val=-top, max_val=top)
        for task in (self.lines, self._zero_lines):
            task.do_channels.add_do_chan(lines, line_grouping=LineGrouping.CHAN_FOR_ALL_LINES)
        self._reader = AnalogMultiChannelReader(self.inputs.in_stream)
        self._output_writer = AnalogMultiChannelWriter(self.outputs.out_stream, auto_start=False)
        self._line_writer = DigitalSingleChannelWriter(self.lines.out_stream, auto_start=False)
        self._zero_output_writer = AnalogMultiChannelWriter(self._zero_outputs.out_stream, auto_start=True)
        self._zero_line_writer = DigitalSingleChannelWriter(self._zero_lines.out_stream, auto_start=True)
        for stream in (
            self._reader, self._output_writer, self._line_writer, self._zero_output_writer, self._zero_line_writer,
        ):  # fmt: skip
            stream.verify_array_shape = False  # it queries the server with every call
        self._set_clock("outputs", 2)
        self.outputs.triggers.start_trigger.cfg_dig_edge_start_trig(f"/{name}/ai/StartTrigger")
        self._set_clock("lines", 2)
        self._set_clock("inputs", 2)
        self._write_zeros()

    def play(self, waveform: Waveform, guard: OutputGuard) -> tuple[FloatArray | None, float]:
        """Play one shot. The `guard` is armed while anything is driven.

        Parameters
        ----------
        waveform : Waveform
        guard : OutputGuard

        Returns
        -------
        volts : ndarray, shape (n_inputs, n), in V, or None
            Samples of the listening window.
        began : float, in s
            Start of the first sample on the monotonic clock.

        Raises
        ------
        LostWindow
            If the samples did not arrive; outputs are at zero.
        RigError
            For every other failure.
        """
        try:
            with self._translate_errors("play a shot"):
                return self._play(waveform, guard)
        except BaseException:
            if self.zero_outputs():
                guard.disarm()
            else:
                guard.abandon()
            raise

    def _play(self, waveform: Waveform, guard: OutputGuard) -> tuple[FloatArray | None, float]:
        driven = waveform.outputs > 0
        self._set_clock("inputs", waveform.samples)
        if driven:
            self._set_clock("outputs", waveform.outputs)
            self._set_clock("lines", waveform.outputs)
            self._output_writer.write_many_sample(np.ascontiguousarray(waveform.volts), timeout=self._call_timeout)
            self._line_writer.write_many_sample_port_uint32(waveform.lines, timeout=self._call_timeout)
            guard.arm()
            self.lines.start()
            self.outputs.start()
        before = time.monotonic()
        self.inputs.start()
        began = 0.5 * (before + time.monotonic())
        volts = np.zeros((len(self._section.inputs.channels), waveform.samples))
        for first, end in self._split_reads(waveform):
            self._read(volts, first, end)
            if driven and end >= waveform.settled:
                self.outputs.stop()
                self.lines.stop()
                guard.check_relays_open()
                guard.disarm()
                driven = False
        self.inputs.stop()
        if waveform.listen is None:
            return None, began
        first, count = waveform.listen
        return volts[:, first : first + count], began

    def _split_reads(self, waveform: Waveform) -> Iterator[tuple[int, int]]:
        """Split the samples into spans that are read one after the other.

        One span ends where the relays are open, and the last one is short.
        """
        last = waveform.samples - max(round(LAST_READ_DURATION * self._rate), 1)
        marks = sorted({0, waveform.settled, max(last, waveform.settled), waveform.samples})
        longest = max(int(MAX_READ_DURATION * self._rate), 1)
        for begin, end in itertools.pairwise(marks):
            count = -(-(end - begin) // longest)
            edges = [begin + round(k * (end - begin) / count) for k in range(count + 1)]
            yield from itertools.pairwise(edges)

    def _read(self, volts: FloatArray, first: int, end: int) -> None:
        if self._stopped.is_set():
            raise RigError("Stopped during a shot; every output is at zero.")
        piece = np.zeros((len(volts), end - first))
        got = self._reader.read_many_sample(piece, end - first, timeout=READ_TIMEOUT + (end - first) / self._rate)
        if got != end - first:
            raise LostWindow(f"{got} of {end - first} samples came")
        volts[:, first:end] = piece

    def test_inputs(self) -> None:
        """Record for a moment with nothing driven, to test the inputs.

        Raises
        ------
        LostWindow
            If no samples arrive.
        RigError
            For every other failure.
        """
        with self._translate_errors("listen"):
            self._set_clock("inputs", TEST_SAMPLES)
            self.inputs.start()
            self._read(np.zeros((len(self._section.inputs.channels), TEST_SAMPLES)), 0, TEST_SAMPLES)
            self.inputs.stop()

    def stop(self) -> bool:
        """Set all outputs to zero for good: this card plays nothing any more.

        Returns
        -------
        bool
            As `silence`.
        """
        self._stopped.set()
        return self.zero_outputs()

    def zero_outputs(self) -> bool:
        """Abort what is playing; set outputs to zero, disable the amplifiers, open the relays.

        Safe from any thread; never raises.

        Returns
        -------
        bool
            Whether the card did so; if not, its watchdog opens the relays.
        """
        from nidaqmx.constants import TaskMode

        for task in (self.lines, self.outputs, self.inputs):
            self._driver.attempt(functools.partial(task.control, TaskMode.TASK_ABORT))
        self._lengths.clear()
        return self._write_zeros()

    def _write_zeros(self) -> bool:
        """Open the relays, which stops every current, then zero the outputs; return whether both succeeded."""

        def lines() -> None:
            self._zero_line_writer.write_one_sample_port_uint32(0, timeout=READ_TIMEOUT)
            self._zero_lines.stop()

        def outputs() -> None:
            self._zero_output_writer.write_one_sample(np.zeros(len(self._section.used_outputs)), timeout=READ_TIMEOUT)
            self._zero_outputs.stop()

        done = self._driver.attempt(lines)
        return self._driver.attempt(outputs) and done

    def close(self) -> None:
        """Close every task. Outputs keep their values, so call `silence` first."""
        for task in self._tasks:
            self._driver.attempt(task.close)
        self._tasks.clear()

    def _make_task(self) -> Any:
        task = self._driver.task()
        self._tasks.append(task)
        return task

    def _set_clock(self, which: str, count: int) -> None:
        """Set sample clock and length of a task, unless they are set already."""
        if self._lengths.get(which) == count:
            return
        rate = self._rate if which == "inputs" else self._section.outputs.rate_hz
        source = f"/{self._section.device}/ao/SampleClock" if which == "lines" else ""
        getattr(self, which).timing.cfg_samp_clk_timing(rate, source=source, samps_per_chan=count)
        self._lengths[which] = count

    @contextlib.contextmanager
    def _translate_errors(self, action: str) -> Iterator[None]:
        """Convert errors of the client library to ours, with device and action, and a lost read to `LostWindow`."""
        name = self._section.device
        try:
            yield
        except self._driver.errors as error:
            self._driver.record_error(error)
            if self._driver.is_lost_read(error):
                raise LostWindow(self._driver.explain(error)) from error
            raise RigError(
                f"{name} did not {action}: {self._driver.explain(error)} {self._driver.suggest_remedy(error)}",
                device=name,
            ) from error
