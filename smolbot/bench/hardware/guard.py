"""The guard: a thread that feeds the card's watchdog and monitors the operator's button."""

from __future__ import annotations

import gc
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from smolbot.bench.hardware.driver import Driver
from smolbot.bench.hardware.wiring import BenchSection
from smolbot.core.rig import CheckItem
from smolbot.errors import OperatorStopError, RigError


class Guard:
    """Runs the watchdog while anything is driven: if this program dies or hangs then, it opens every relay.

    Between two drives nothing is energised, and computing may take any time. The button is always monitored.

    Parameters
    ----------
    section : BenchSection
    driver : Driver
    trip : callable
        Called once with the error, from the guard's thread, when the button is pressed or the card fails.

    Attributes
    ----------
    lines : dict of bool
        Level of each wired input line when it was last read.
    """

    def __init__(self, section: BenchSection, driver: Driver, trip: Callable[[RigError], None]) -> None:
        self._section, self._driver, self._trip = section, driver, trip
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._feed_and_watch, name="watchdog feeder", daemon=True)
        self.lines: dict[str, bool] = {}
        self._inputs: Any = None
        self._reader: Any = None
        self._armed = threading.Lock()
        self._feeding = False
        self._watchdog: Any = None

    def open(self) -> None:
        """Set up the watchdog, read the lines once, and start the thread.

        Raises
        ------
        RigError
            If the watchdog cannot be set up, or the operator's button is pressed.
        """
        from nidaqmx.constants import Level, LineGrouping
        from nidaqmx.stream_readers import DigitalMultiChannelReader
        from nidaqmx.types import DOExpirationState

        section, name = self._section, self._section.device
        try:
            if section.input_lines:
                self._inputs = self._driver.task(urgent=True)
                wired = ", ".join(f"{name}/{line}" for line in section.input_lines)
                self._inputs.di_channels.add_di_chan(wired, line_grouping=LineGrouping.CHAN_PER_LINE)
                self._reader = DigitalMultiChannelReader(self._inputs.in_stream)
                self._reader.verify_array_shape = False  # it queries the server with every read
                self._read_lines()
            self._watchdog = self._driver.make_watchdog(name, section.watchdog.timeout)
            states = [DOExpirationState(f"{name}/{line}", Level.LOW) for line in section.clocked_lines]
            self._watchdog.cfg_watchdog_do_expir_states(states)
        except self._driver.errors as error:
            raise RigError(
                f"The watchdog of {name} cannot be set up: {self._driver.explain(error)}", device=name
            ) from error
        pressed = self.describe_pressed_button()
        if pressed:
            raise RigError(pressed)
        self._thread.start()

    def arm(self) -> None:
        """Start the watchdog, before something is driven."""
        gc.disable()  # a look through all of the program's memory takes as long as the watchdog waits
        with self._armed:
            self._watchdog.start()
            self._feeding = True

    def disarm(self) -> None:
        """Stop the watchdog, once nothing is driven any more."""
        gc.enable()
        with self._armed:
            if self._feeding:
                self._feeding = False
                self._driver.attempt(self._watchdog.stop)

    def abandon(self) -> None:
        """Stop feeding the watchdog: something may still be driven, and its expiry opens the relays."""
        gc.enable()
        self._feeding = False

    def describe_pressed_button(self) -> str | None:
        """Return why the run must stop, if the operator's button is pressed.

        Returns
        -------
        str or None
            None if it is not pressed, or not wired to the card.
        """
        line = self._section.operator.stop_line
        if line is None or self.lines.get(line, True):
            return None
        return (
            f"Stopped by the operator's button ({self._section.device}/{line} is low: pressed, or its cable is broken)."
        )

    def check_relays_open(self) -> None:
        """Check by the relays' auxiliary contacts that all relays are open; does nothing if these are not wired.

        Raises
        ------
        RigError
            If one is closed.
        """
        line = self._section.relays.all_open
        if line is None:
            return
        self._read_lines()
        if not self.lines[line]:
            raise RigError(
                f"{self._section.device}: a relay did not open after a shot ({line} is low). Amplifiers are off and "
                "outputs at zero; switch off the supply and look for the relay whose contacts stick.",
                device=self._section.device,
            )

    def checks(self, card: str) -> Iterator[CheckItem]:
        """Check that the watchdog can be started, fed and stopped, and read the lines; nothing is driven.

        Parameters
        ----------
        card : str
            Name of the card in the check items.

        Yields
        ------
        CheckItem
        """
        section = self._section
        try:
            self.arm()
            self._watchdog.reset_timer()
            self.disarm()
        except self._driver.errors as error:
            yield CheckItem(card, "watchdog", self._driver.explain(error), False, "starts and is fed")
            return
        timeout = section.watchdog.timeout_ms
        yield CheckItem(card, "watchdog", f"starts, is fed and stops; opens relays after {timeout:g} ms")
        if section.input_lines:
            self._read_lines()
        if section.relays.all_open is not None:
            opened = self.lines[section.relays.all_open]
            yield CheckItem(card, "relays", "all open" if opened else "one is closed", opened, "all open")
        if section.operator.stop_line is not None:
            pressed = self.describe_pressed_button() is not None
            yield CheckItem(
                card, "operator's button", "pressed" if pressed else "not pressed", not pressed, "not pressed"
            )

    def _read_lines(self) -> None:
        levels = np.zeros(len(self._section.input_lines), np.bool_)
        self._reader.read_one_sample_one_line(levels, timeout=self._section.call_timeout)
        self.lines = dict(zip(self._section.input_lines, levels.tolist(), strict=True))

    def _feed_and_watch(self) -> None:
        pause = self._section.watchdog.feed
        due = time.monotonic()
        while not self._end.is_set():
            try:
                with self._armed:
                    if self._feeding:
                        self._watchdog.reset_timer()
                if self._inputs is not None:
                    self._read_lines()
            except self._driver.errors as error:
                self._driver.record_error(error)
                self._feeding = False
                if not self._end.is_set():
                    self._trip(
                        RigError(
                            f"{self._section.device} did not answer to its watchdog's feeding: "
                            f"{self._driver.explain(error)} {self._driver.suggest_remedy(error)}",
                            device=self._section.device,
                        )
                    )
                return
            pressed = self.describe_pressed_button()
            if pressed:
                self._trip(OperatorStopError(pressed))
                return
            due = max(due + pause, time.monotonic())  # a late feed is not made up for
            self._end.wait(max(due - time.monotonic(), 0.0))

    def close(self) -> None:
        """End the thread, then stop and close the watchdog; it does not expire."""
        self._end.set()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(2.0)
        for task in (self._watchdog, self._inputs):
            if task is not None:
                self._driver.attempt(task.stop)
                self._driver.attempt(task.close)
        self._watchdog = self._inputs = None
