"""Tasks of the twin's card, as clients created them."""

from __future__ import annotations

import itertools
import threading
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sim.twin.card_model import (
    NOT_STARTED,
    UNKNOWN_DEVICE,
    UNKNOWN_TASK,
    UNSUPPORTED,
    WRONG_COUNT,
    WRONG_SOURCE,
    CardError,
    CardModel,
)
from smolbot.bench.hardware.products import PRODUCTS, Product
from smolbot.bench.hardware.waveform import get_line_bit
from smolbot.core.arrays import FloatArray

RATE_TOLERANCE = 1e-6
"""Relative difference of two sample rates that is rounding."""

MIN_SAMPLES = 2
"""Fewest samples of a finite task, as in the driver."""


@dataclass
class TwinTask:
    """One task.

    Attributes
    ----------
    name : str
    kind : {"", "ai", "ao", "do", "di", "watchdog"}
    channels : list of str
        Without the device's name.
    rate : float, in Hz
        Of its sample clock; 0 if it has none.
    count : int
        Samples per channel; 0 without a sample clock.
    source, trigger : str
        Terminals of sample clock and start trigger.
    buffer : ndarray or None
        Samples for the next start.
    running : bool
    timeout : float, in s
        Of a watchdog.
    grouped : bool
        Whether its lines are one channel.
    """

    name: str
    kind: str = ""
    channels: list[str] = field(default_factory=list)
    rate: float = 0.0
    count: int = 0
    source: str = ""
    trigger: str = ""
    buffer: Any = None
    running: bool = False
    timeout: float = 0.0
    grouped: bool = False


class Tasks:
    """All tasks of one card. Raises `CardError` as the driver would.

    Parameters
    ----------
    card : CardModel

    Attributes
    ----------
    card : CardModel
    device : str
        Name of the device.
    product : Product
    """

    def __init__(self, card: CardModel) -> None:
        self.card, self.device = card, card.section.device
        self.product: Product = PRODUCTS[card.section.product]
        self._tasks: dict[str, TwinTask] = {}
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()

    def create(self, requested: str, kind: str = "") -> TwinTask:
        """Create a task.

        Parameters
        ----------
        requested : str
            Requested name; empty for any.
        kind : str
            See `TwinTask`.

        Returns
        -------
        TwinTask

        Raises
        ------
        CardError
            If the name exists.
        """
        with self._lock:
            name = requested or f"_unnamedTask<{next(self._numbers)}>"
            if name in self._tasks:
                raise CardError(-200089, f"Task name '{name}' conflicts with an existing task name.")
            self._tasks[name] = TwinTask(name, kind)
            return self._tasks[name]

    def get(self, name: str) -> TwinTask:
        """Return a task by its session name.

        Parameters
        ----------
        name : str

        Returns
        -------
        TwinTask

        Raises
        ------
        CardError
            If there is none.
        """
        found = self._tasks.get(name)
        if found is None:
            raise CardError(UNKNOWN_TASK, f"Task specified is invalid or does not exist: '{name}'.")
        return found

    def clear(self, name: str) -> None:
        """Stop and remove a task.

        Parameters
        ----------
        name : str
        """
        task = self.get(name)
        self.stop(task)
        with self._lock:
            self._tasks.pop(name, None)

    def clear_all(self) -> None:
        """Stop every task and reset the card."""
        for task in tuple(self._tasks.values()):
            task.running, task.buffer = False, None
        self.card.reset()

    def add_channels(
        self, task: TwinTask, kind: str, names: str, span: tuple[float, float] | None = None, terminal: str = ""
    ) -> None:
        """Add channels to a task.

        Parameters
        ----------
        task : TwinTask
        kind : {"ai", "ao", "do", "di"}
        names : str
            Such as ``Dev1/ai0, Dev1/ai1:3``.
        span : tuple of 2, in V, optional
            Lowest and highest value.
        terminal : str
            Terminal configuration of inputs.

        Raises
        ------
        CardError
            If a channel does not exist, is there twice, or cannot have the range.
        """
        exist = {
            "ai": self.product.get_inputs(terminal),
            "ao": self.product.outputs,
            "do": self.product.lines,
            "di": self.product.lines,
        }[kind]
        for name in expand_channels(names):
            device, _, channel = name.partition("/")
            if device != self.device:
                raise CardError(
                    UNKNOWN_DEVICE, f"Device identifier is invalid: '{device}'; this machine has '{self.device}'."
                )
            if channel not in exist:
                raise CardError(-200170, f"Physical channel specified does not exist on this device: '{name}'.")
            if channel in task.channels:
                raise CardError(-200489, f"Channel '{name}' is in the task twice.")
            task.channels.append(channel)
        ranges = self.product.input_ranges if kind == "ai" else self.product.output_ranges
        if span is not None and max(abs(span[0]), abs(span[1])) > max(ranges):
            raise CardError(UNSUPPORTED, f"Requested value is not supported: ±{max(ranges):g} V is the widest range.")
        task.kind = kind

    def set_clock(self, task: TwinTask, rate: float, source: str, count: int) -> None:
        """Set sample clock and length of a task.

        Parameters
        ----------
        task : TwinTask
        rate : float, in Hz
        source : str
            Terminal of the clock.
        count : int
            Samples per channel.

        Raises
        ------
        CardError
            If the task cannot have them.
        """
        if task.kind in ("", "di"):
            raise CardError(UNSUPPORTED, "This task cannot have a sample clock.")
        if task.running:
            raise CardError(-200557, "The task is running; its timing cannot be changed.")
        if task.kind == "do" and not set(task.channels) <= set(self.product.clocked_lines):
            raise CardError(UNSUPPORTED, "Only lines of port 0 follow a sample clock.")
        most = (
            self.product.max_input_rate / max(len(task.channels), 1)
            if task.kind == "ai"
            else self.product.max_output_rate
        )
        expected = self.card.plant.rate if task.kind == "ai" else self.card.section.outputs.rate_hz
        if not 0 < rate <= most:
            raise CardError(UNSUPPORTED, f"Sample rate {rate:g} exceeds the {most:g} Hz that this task can have.")
        if abs(rate - expected) > RATE_TOLERANCE * expected:
            raise CardError(UNSUPPORTED, f"The twin of this bench runs at {expected:g} Hz; got {rate:g}.")
        if count < MIN_SAMPLES:
            raise CardError(UNSUPPORTED, f"A finite task has at least {MIN_SAMPLES} samples per channel.")
        task.rate, task.count, task.source, task.buffer = rate, int(count), source, None

    def read(self, task: TwinTask, count: int, timeout: float) -> FloatArray:
        """Return the next samples of a task's inputs; inputs that are not wired read zero.

        A task that was not started is started, as by the driver.

        Parameters
        ----------
        task : TwinTask
        count : int
        timeout : float, in s

        Returns
        -------
        ndarray, shape (n_channels, count), in V

        Raises
        ------
        CardError
            If they are not acquired in time, or were lost.
        """
        if not task.running:
            self.start(task)
        volts, wired = self.card.read(count, timeout), self.card.section.inputs.channels
        if task.channels == wired:
            return volts
        out = np.zeros((len(task.channels), count))
        for row, channel in enumerate(task.channels):
            if channel in wired:
                out[row] = volts[wired.index(channel)]
        return out

    def write(self, task: TwinTask, values: FloatArray, auto_start: bool) -> None:
        """Write samples for a task's outputs.

        Parameters
        ----------
        task : TwinTask
        values : ndarray, shape (n_channels, n), in V
        auto_start : bool
            Required for a task without a sample clock, which outputs the last sample at once.

        Raises
        ------
        CardError
            If a value is out of range, or the number of samples is wrong.
        """
        if self.card.faults.take("value_out_of_range") or np.any(np.abs(values) > self.card.section.outputs.range_v):
            raise CardError(
                UNSUPPORTED,
                "Requested value is not a supported value for this property: a voltage beyond the range.",
                written=0,
            )
        if task.count:
            if values.shape[1] != task.count:
                raise CardError(
                    WRONG_COUNT, f"Write {task.count} samples per channel; got {values.shape[1]}.", written=0
                )
            task.buffer = values
        elif not auto_start:
            raise CardError(NOT_STARTED, "An on-demand write starts the task by itself.", written=0)
        else:
            self._check_free("ao")
            self.card.set_outputs(self._merge_outputs(task, values[:, -1]))

    def write_lines(self, task: TwinTask, levels: Any, auto_start: bool) -> None:
        """Write samples for a task's digital lines.

        Parameters
        ----------
        task : TwinTask
        levels : ndarray of uint32, shape (n,)
            One bit per line.
        auto_start : bool
            Required for a task without a sample clock, which outputs the last sample at once.

        Raises
        ------
        CardError
            If the number of samples is wrong.
        """
        mask = np.uint32(sum(1 << get_line_bit(line) for line in task.channels))
        if task.count:
            if len(levels) != task.count:
                raise CardError(WRONG_COUNT, f"Write {task.count} samples; got {len(levels)}.", written=0)
            task.buffer = levels & mask
        elif not auto_start:
            raise CardError(NOT_STARTED, "An on-demand write starts the task by itself.", written=0)
        else:
            self._check_free("do")
            self.card.set_lines(int(levels[-1] & mask))

    def start(self, task: TwinTask) -> None:
        """Start a task, or arm one that waits for a trigger.

        Parameters
        ----------
        task : TwinTask

        Raises
        ------
        CardError
            If samples or trigger are missing, or another task uses the hardware.
        """
        if task.kind == "watchdog":
            mask = sum(1 << get_line_bit(line) for line in task.channels)
            self.card.set_watchdog(task.timeout, mask)
        elif task.kind == "ai":
            self._check_free("ai")
            self.card.acquire(task.count)
        elif task.kind in ("ao", "do") and task.count:
            self._check_free(task.kind)
            if task.buffer is None:
                raise CardError(-200462, "Write samples before the task is started.")
            if task.kind == "ao":
                if task.trigger != f"/{self.device}/ai/StartTrigger":
                    raise CardError(
                        WRONG_SOURCE,
                        f"The twin's outputs wait for /{self.device}/ai/StartTrigger; got '{task.trigger}'.",
                    )
                self.card.arm(outputs=self._order_rows(task))
            else:
                if task.source != f"/{self.device}/ao/SampleClock":
                    raise CardError(
                        WRONG_SOURCE, f"The twin's lines follow /{self.device}/ao/SampleClock; got '{task.source}'."
                    )
                self.card.arm(lines=task.buffer)
        task.running = True

    def stop(self, task: TwinTask) -> None:
        """Stop a task; its outputs hold their values.

        Parameters
        ----------
        task : TwinTask
        """
        if not task.running:
            return
        task.running = False
        if task.kind == "watchdog":
            self.card.set_watchdog(None)
        elif task.kind == "ai":
            self.card.stop_inputs()
        elif task.kind == "ao" and task.count:
            self.card.stop_outputs()
        elif task.kind == "do" and task.count:
            self.card.stop_lines()

    def wait(self, task: TwinTask, timeout: float) -> bool:
        """Wait until a task is done.

        Parameters
        ----------
        task : TwinTask
        timeout : float, in s

        Returns
        -------
        bool
            Whether it is done in time.
        """
        if task.kind not in ("ai", "ao", "do") or not task.count or not task.running:
            return True
        return self.card.wait(task.kind, timeout)

    def _check_free(self, kind: str) -> None:
        if any(t.kind == kind and t.running and t.count for t in self._tasks.values()):
            raise CardError(-50103, "The specified resource is reserved: one hardware-timed task of a kind at a time.")

    def _merge_outputs(self, task: TwinTask, values: FloatArray) -> FloatArray:
        used = self.card.section.used_outputs
        out = np.array(self.card.read_state()["outputs_v"])
        for channel, value in zip(task.channels, values, strict=True):
            if channel in used:
                out[used.index(channel)] = value
        return out

    def _order_rows(self, task: TwinTask) -> FloatArray:
        used = self.card.section.used_outputs
        out = np.zeros((len(used), task.count))
        for channel, row in zip(task.channels, task.buffer, strict=True):
            if channel in used:
                out[used.index(channel)] = row
        return out


def expand_channels(names: str) -> list[str]:
    """Expand a list of channels in the driver's spelling.

    Parameters
    ----------
    names : str

    Returns
    -------
    list of str

    Examples
    --------
    >>> expand_channels("Dev1/ai0:2, Dev1/port0/line6")
    ['Dev1/ai0', 'Dev1/ai1', 'Dev1/ai2', 'Dev1/port0/line6']
    """
    out = []
    for part in names.split(","):
        name, _, last = part.strip().partition(":")
        if not last:
            out.append(name)
            continue
        stem = name.rstrip("0123456789")
        out += [
            f"{stem}{k}" for k in range(int(name[len(stem) :]), int(last.lstrip("abcdefghijklmnopqrstuvwxyz/")) + 1)
        ]
    return out
