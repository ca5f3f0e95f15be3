"""The twin's simulated data acquisition card, in real time: outputs, clocked lines, inputs and a watchdog."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from sim.twin.faults import FaultInjector
from sim.twin.journal import Journal, OutputMonitor
from sim.twin.relays_and_amplifiers import RelaysAndAmplifiers
from smolbot.bench.hardware.wiring import BenchSection
from smolbot.core.arrays import FloatArray

POLL_INTERVAL = 2e-3
"""Time, in s, between two checks of the clock; a waiting reader is served as soon as its sample exists."""

MAX_STEP_SAMPLES = 250
"""Samples that are played in one step, while the card is locked."""

LOCK_RELEASE_TIME = 1e-4
"""Time, in s, for which the card is unlocked between two steps while it catches up: a lock that is released and taken
at once goes to no other thread."""

MAX_LINE_WAIT = 0.02
"""Longest time, in s, that reading a contact waits until the card has played up to now."""

MIN_LOGGED_DELAY = 0.03
"""Time, in s, between two checks of the clock above which the journal notes that this computer was busy."""

MAX_CATCH_UP = 0.5
"""Delay, in s, that the card makes up for when this computer was busy; older time is skipped by the clock."""

ACTUATION_FAULT_DELAY = 0.010
LISTENING_FAULT_LEAD = 0.004
"""Times, in s, after the start of a shot and before its end, at which faults of these phases occur."""

ALL_LINES = 0xFFFFFFFF
"""Mask of the 32 lines of a port."""

SATURATED = 10.0
"""Voltage of a saturated sensor, in V."""

JOIN_TIMEOUT = 2.0
"""Longest time, in s, for the card's thread to end."""

# Error codes of the driver that occur in several places
UNSUPPORTED, UNKNOWN_DEVICE, UNKNOWN_TASK, DEVICE_GONE = -200077, -200220, -200088, -201003
WRONG_COUNT, NOT_STARTED, WRONG_SOURCE = -200524, -200547, -200040


class CardError(Exception):
    """An error of the card, with its number in the driver.

    Parameters
    ----------
    code : int
        Number of the error.
    message : str
    read, written : int, optional
        Samples per channel that were read or written before the error.
    """

    def __init__(self, code: int, message: str, read: int | None = None, written: int | None = None) -> None:
        super().__init__(message)
        self.code, self.read, self.written = code, read, written


class CardPlant(Protocol):
    """The simulated world that the card is wired to.

    Attributes
    ----------
    rate : float, in Hz
    loads : tuple of str
        Names of the driven coils.
    played : int
        Samples since the beginning.
    """

    rate: float
    loads: tuple[str, ...]
    played: int

    def advance(self, currents: FloatArray) -> None:
        """Advance by as many samples as `currents` has columns.

        Parameters
        ----------
        currents : ndarray, shape (n_loads, n), in A
        """

    def begin_acquisition(self) -> None:
        """Begin a new recording."""

    def read_volts(self, first: int, n: int) -> FloatArray:
        """Return samples of the inputs that were played.

        Parameters
        ----------
        first : int
            Index of the first sample.
        n : int

        Returns
        -------
        ndarray, shape (n_inputs, n), in V
        """


@dataclass
class Generation:
    """A buffer that is played once.

    Attributes
    ----------
    samples : ndarray, shape (n_channels, n)
        In V for outputs, one word per sample for lines.
    start : int or None
        Index of the sample at which it starts; None while it waits for the trigger.
    """

    samples: NDArray[Any]
    start: int | None = None


@dataclass
class Acquisition:
    """An acquisition of samples `start` to ``start + count`` of the inputs.

    Attributes
    ----------
    start, count : int
    taken : int
        Samples that were read.
    shot : int
        Number of the electrical shot; 0 for one that drives nothing.
    phases : list of tuple of int and str
        Samples at which phases of the shot begin, for faults.
    """

    start: int
    count: int
    taken: int = 0
    shot: int = 0
    phases: list[tuple[int, str]] = field(default_factory=list)


class CardModel:
    """One card. Its thread keeps card and plant in step with the wall clock; every method is safe from any thread.

    The watchdog runs in the same thread and needs no server.

    Parameters
    ----------
    section : BenchSection
    plant : CardPlant
    before_step : callable, optional
        Called in the card's thread before every step, with the step's end in s: moves the magnet stage.

    Attributes
    ----------
    journal : Journal
    faults : FaultInjector
    monitor : OutputMonitor
    outputs, clocked : Generation or None
        Playing or armed on the outputs and on the clocked lines.
    inputs : Acquisition or None
    failure : str or None
        The error that ended the plant.
    """

    def __init__(
        self, section: BenchSection, plant: CardPlant, before_step: Callable[[float], None] | None = None
    ) -> None:
        self.section, self.plant = section, plant
        self._before_step = before_step
        self.journal = Journal()
        self.faults = FaultInjector(lambda name: self.journal.add("fault", name=name))
        self.monitor = OutputMonitor(self.journal, plant.rate)
        self._contacts = RelaysAndAmplifiers(section, plant.loads)
        self._changed = threading.Condition(threading.RLock())
        self._held = np.zeros(len(section.used_outputs))
        self._lines = 0
        self._all_open = True
        self.outputs: Generation | None = None
        self.clocked: Generation | None = None
        self.inputs: Acquisition | None = None
        self._watchdog: float | None = None  # its timeout, in s
        self._last_feed = 0.0
        self._expired = False
        self._safe_lines = ALL_LINES  # mask of the lines after the watchdog has expired
        self._awaited: list[int] = []
        self._shots = 0
        self._end = False
        self.failure: str | None = None
        self._epoch = time.monotonic()
        self._thread = threading.Thread(target=self._run, name="card", daemon=True)

    # the card's own thread

    def start(self) -> None:
        """Start the card's clock and thread."""
        self._epoch = time.monotonic() - self.plant.played / self.plant.rate
        self._thread.start()

    def close(self) -> None:
        """End the card's thread."""
        self._end = True
        with self._changed:
            self._changed.notify_all()
        if self._thread.is_alive():
            self._thread.join(JOIN_TIMEOUT)

    def compute_time(self, sample: int) -> float:
        """Return the time at which a sample is played.

        Parameters
        ----------
        sample : int

        Returns
        -------
        float, in s
            On the monotonic clock.
        """
        return self._epoch + sample / self.plant.rate

    def _run(self) -> None:
        latest = time.monotonic()
        while not self._end:
            with self._changed:
                now = time.monotonic()
                if now - latest > MIN_LOGGED_DELAY:
                    self.journal.add("late", seconds=now - latest)
                latest = now
                try:
                    behind = self._play_step()
                except Exception as error:  # the tank failed: readers get the error, the thread does not end silently
                    self.failure = f"{type(error).__name__}: {error}"
                    self.journal.add("broken", error=self.failure)
                    self._end, behind = True, False
                self._changed.notify_all()
                wake = min([self.compute_time(sample) for sample in self._awaited], default=np.inf)
            self.faults.activate_due()
            pause = LOCK_RELEASE_TIME if behind else min(POLL_INTERVAL, wake - time.monotonic())
            if pause > 0:
                time.sleep(pause)

    def _catch_up(self) -> None:
        """Play all samples until now."""
        while self._play_step():
            pass

    def _play_step(self) -> bool:
        """Play at most one step towards now; return whether there is more to play."""
        rate = self.plant.rate
        target = int((time.monotonic() - self._epoch) * rate)
        late = target - self.plant.played - int(MAX_CATCH_UP * rate)
        if late > 0:  # this computer was busy: time continues from here, nothing is played in a burst
            self._epoch += late / rate
            target -= late
            self.journal.add("stood still", seconds=late / rate)
        if self.plant.played < target:
            self._play_samples(min(target - self.plant.played, MAX_STEP_SAMPLES))
        return self.plant.played < target

    def _play_samples(self, n: int) -> None:
        first = self.plant.played
        if self._watchdog is not None and not self._expired:
            late = self.compute_time(first) - self._last_feed > self._watchdog
            if late or self.faults.take("watchdog_expired"):
                self._expired = True
                self.journal.add("watchdog expired", self.compute_time(first))
        if self._before_step is not None:
            self._before_step(self.compute_time(first + n))
        if self.faults.is_active("outputs_frozen"):
            volts, lines = np.repeat(self._held[:, None], n, axis=1), np.full(n, self._lines, np.uint32)
            self.outputs = self.clocked = None
        else:
            volts, lines = self._compute_volts(first, n), self._compute_levels(first, n)
        if self._expired:
            lines = lines & np.uint32(self._safe_lines)
        self._update_stuck_relay()
        currents, contacts, enabled = self._contacts.compute_currents(first, volts, lines)
        free = [load for load in range(len(contacts)) if load != self._contacts.stuck]
        self._all_open = not bool(self._contacts.closed.any())
        self.monitor.update(first, self._epoch, currents, contacts[free], enabled)
        self.plant.advance(currents)
        self._notify_phases(first + n)

    def _compute_volts(self, first: int, n: int) -> FloatArray:
        volts = np.repeat(self._held[:, None], n, axis=1)
        playing = self.outputs
        if playing is not None and playing.start is not None:
            self._overlay(volts, playing, first, n)
            self._held = volts[:, -1].copy()
        return volts

    def _compute_levels(self, first: int, n: int) -> NDArray[np.uint32]:
        lines = np.full((1, n), self._lines, np.uint32)
        playing = self.clocked
        if playing is not None and playing.start is not None:
            self._overlay(lines, playing, first, n)
            self._lines = int(lines[0, -1])
        return lines[0]

    @staticmethod
    def _overlay(out: NDArray[Any], playing: Generation, first: int, n: int) -> None:
        """Overwrite held values with what is played; after its end it holds its last sample."""
        assert playing.start is not None
        length = playing.samples.shape[1]
        begin = max(playing.start, first)
        if begin >= first + n:
            return
        indices = np.minimum(np.arange(begin, first + n) - playing.start, length - 1)
        out[:, begin - first :] = playing.samples[:, indices]

    def _update_stuck_relay(self) -> None:
        contacts = self._contacts
        if not self.faults.is_active("relay_stuck"):
            contacts.release_stuck()
        elif contacts.stuck is None and contacts.closed.any():
            contacts.stuck = int(np.flatnonzero(contacts.closed)[0])
            self.journal.add("relay stuck", load=self.plant.loads[contacts.stuck])

    def _notify_phases(self, reached: int) -> None:
        going = self.inputs
        while going is not None and going.phases and reached >= going.phases[0][0]:
            _, phase = going.phases.pop(0)
            self.journal.add("phase", phase=phase, shot=going.shot)
            self.faults.notify_phase(phase, going.shot)

    # calls of a client

    def arm(self, outputs: FloatArray | None = None, lines: NDArray[np.uint32] | None = None) -> None:
        """Let outputs, or lines on the outputs' clock, wait for the trigger.

        Parameters
        ----------
        outputs : ndarray, shape (n_outputs, n), in V, optional
        lines : ndarray of uint32, shape (n,), optional
            One bit per line.
        """
        with self._changed:
            if outputs is not None:
                self.outputs = Generation(outputs)
            if lines is not None:
                self.clocked = Generation(lines[None, :])

    def acquire(self, count: int) -> None:
        """Start the inputs, and with them whatever is armed.

        Parameters
        ----------
        count : int
            Samples of each input.
        """
        with self._changed:
            start = int((time.monotonic() - self._epoch) * self.plant.rate) + 1
            start = max(start, self.plant.played)
            driven = False
            for waiting in (self.outputs, self.clocked):
                if waiting is not None and waiting.start is None:
                    waiting.start, driven = start, True
            going = Acquisition(start, count)
            if driven:
                self._shots += 1
                rate = self.plant.rate
                going.shot = self._shots
                going.phases = [
                    (start + int(ACTUATION_FAULT_DELAY * rate), "actuation"),
                    (start + count - int(LISTENING_FAULT_LEAD * rate), "listening"),
                ]
            self.inputs = going
            self.plant.begin_acquisition()
            self.journal.add(
                "shot" if driven else "quiet shot", self.compute_time(start), shot=going.shot, samples=count
            )

    def read(self, count: int, timeout: float) -> FloatArray:
        """Return the next samples of the inputs, as soon as they are acquired.

        Parameters
        ----------
        count : int
        timeout : float, in s

        Returns
        -------
        ndarray, shape (n_inputs, count), in V

        Raises
        ------
        CardError
            If they are not acquired in time, or were lost.
        """
        with self._changed:
            going = self.inputs
            if going is None:
                raise CardError(UNKNOWN_TASK, "The task is not running, so that no samples come.")
            if going.taken + count > going.count:
                raise CardError(-200278, "Attempted to read a sample beyond the final sample acquired.", read=0)
            needed, until = going.start + going.taken + count, time.monotonic() + timeout
            self._awaited.append(needed)
            try:
                there = self._changed.wait_for(
                    lambda: self.plant.played >= needed or self.inputs is not going or self._end, timeout
                )
            finally:
                self._awaited.remove(needed)
            if self.inputs is not going:
                raise CardError(-88709, "The task was aborted.", read=0)
            if self._end:
                raise CardError(DEVICE_GONE, "Device cannot be accessed: the twin's tank has ended.", read=0)
            if self.faults.take("overrun"):
                raise CardError(
                    -200279, "The application is not able to keep up with the hardware acquisition.", read=0
                )
            if there and self.faults.take("read_timeout"):
                self._changed.wait_for(lambda: self.inputs is not going or self._end, until - time.monotonic())
                there = False
            if not there:
                raise CardError(-200284, "Some or all of the samples requested have not yet been acquired.", read=0)
            volts = self.plant.read_volts(going.start + going.taken, count)
            going.taken += count
            if self.faults.is_active("sensor_dead"):
                volts[0] = 0.0
            if self.faults.is_active("sensors_saturated"):
                volts[:] = SATURATED
            return volts

    def count_acquired(self) -> int:
        """Return the number of samples of each input since the acquisition began.

        Returns
        -------
        int
        """
        with self._changed:
            going = self.inputs
            return 0 if going is None else min(max(self.plant.played - going.start, 0), going.count)

    def count_available(self) -> int:
        """Return the number of samples of each input that were acquired and not yet read.

        Returns
        -------
        int
        """
        with self._changed:
            return 0 if self.inputs is None else self.count_acquired() - self.inputs.taken

    def wait(self, kind: str, timeout: float) -> bool:
        """Wait until a generation or acquisition has ended.

        Parameters
        ----------
        kind : {"ai", "ao", "do"}
        timeout : float, in s

        Returns
        -------
        bool
            Whether it has ended in time.
        """
        with self._changed:
            return self._changed.wait_for(lambda: self._has_ended(kind) or self._end, timeout) and not self._end

    def _has_ended(self, kind: str) -> bool:
        if kind == "ai":
            return self.inputs is None or self.plant.played >= self.inputs.start + self.inputs.count
        playing = self.outputs if kind == "ao" else self.clocked
        if playing is None:
            return True
        return playing.start is not None and self.plant.played >= playing.start + playing.samples.shape[1]

    def stop_inputs(self) -> None:
        """End the acquisition. After an electrical shot, the phase *before* of the next one begins."""
        with self._changed:
            going, self.inputs = self.inputs, None
        if going is not None and going.shot:
            self.faults.notify_phase("before", going.shot + 1)

    def stop_outputs(self) -> None:
        """End the generation on the outputs, which hold their values."""
        with self._changed:
            self._end_generation("outputs")

    def stop_lines(self) -> None:
        """End the generation on the clocked lines, which hold their levels."""
        with self._changed:
            self._end_generation("clocked")

    def _end_generation(self, which: str) -> None:
        self._catch_up()
        setattr(self, which, None)

    def set_outputs(self, volts: FloatArray) -> None:
        """Set the outputs at once.

        Parameters
        ----------
        volts : ndarray, shape (n_outputs,), in V
        """
        with self._changed:
            self._catch_up()
            self._held = np.array(volts, dtype=float)

    def set_lines(self, levels: int) -> None:
        """Set the levels of the clocked port at once.

        Parameters
        ----------
        levels : int
            One bit per line.
        """
        with self._changed:
            self._catch_up()
            self._lines = levels

    def read_line(self, name: str) -> bool:
        """Return the level of an input line.

        It does not wait for the card's lock, and waits at most `MAX_LINE_WAIT` s until the level is up to date.

        Parameters
        ----------
        name : str

        Returns
        -------
        bool
        """
        if name == self.section.relays.all_open:
            requested = time.monotonic()
            while self.compute_time(self.plant.played) < requested and time.monotonic() < requested + MAX_LINE_WAIT:
                time.sleep(0.5 * POLL_INTERVAL)
            return self._all_open
        if name == self.section.operator.stop_line:
            return not self.faults.is_active("button")
        return False

    def set_watchdog(self, timeout: float | None, safe_lines: int = 0) -> None:
        """Start or stop the watchdog.

        Parameters
        ----------
        timeout : float or None, in s
            None stops it.
        safe_lines : int
            Lines that it sets low when it expires, one bit per line.
        """
        with self._changed:
            if timeout is not None and self._watchdog is None and not self._shots:
                self.faults.notify_phase("before", 1)
            self._watchdog, self._last_feed = timeout, time.monotonic()
            self._safe_lines = ALL_LINES & ~safe_lines
            if timeout is None:
                self._expired = False

    def reset_watchdog_timer(self) -> None:
        """Reset the watchdog's timer, without waiting for the card's lock.

        Raises
        ------
        CardError
            If it has expired.
        """
        if self._expired:
            raise CardError(-200678, "Watchdog timer task has expired; the lines are in their expiration states.")
        self._last_feed = time.monotonic()

    @property
    def expired(self) -> bool:
        """Whether the watchdog has expired."""
        return self._expired

    def reset(self) -> None:
        """Return to the state after power-up: nothing plays, outputs at zero, lines low, no watchdog."""
        with self._changed:
            self._catch_up()
            self.outputs = self.clocked = self.inputs = None
            self._held[:] = 0.0
            self._lines = 0
            self._watchdog, self._expired = None, False
            self._shots = 0
            self.faults.forget_first_shot()
            self.journal.add("reset")

    def wait_until_at_rest(self, timeout: float = 0.0) -> bool:
        """Wait until nothing is driven, the amplifiers are off, and every relay that is not stuck is open.

        Parameters
        ----------
        timeout : float, in s

        Returns
        -------
        bool
            Whether that is so in time.
        """
        lines = self.monitor.driven, self.monitor.closed, self.monitor.enabled
        with self._changed:
            return self._changed.wait_for(lambda: not any(line.on for line in lines), timeout)

    def read_state(self) -> Mapping[str, Any]:
        """Return the card's present state, for monitoring.

        Returns
        -------
        mapping
            Plain lists, numbers and strings; times in s on the monotonic clock.
        """
        with self._changed:
            return {
                "played_s": self.plant.played / self.plant.rate,
                "shots": self._shots,
                "driven": self.monitor.driven.on,
                "relays_closed": [name for name, on in zip(self.plant.loads, self._contacts.closed, strict=True) if on],
                "enabled": self.monitor.enabled.on,
                "outputs_v": self._held.tolist(),
                "last_driven": self.monitor.driven.latest,
                "last_closed": self.monitor.closed.latest,
                "watchdog_expired": self._expired,
                "broken": self.failure,
            }
