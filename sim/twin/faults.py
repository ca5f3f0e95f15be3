"""Faults of a bench, by name: when they occur, and for how long."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from sim.tank.faults import GOOD, ONCE, STATE_DURATION, FaultKind, InjectedFault
from sim.tank.faults import parse_fault as parse_named_fault

FAULTS = {
    "device_gone": "the card no longer answers (-201003)",
    "overrun": "samples were overwritten before they were read (-200279)",
    "read_timeout": "samples do not come in time (-200284)",
    "stalled": "the device server accepts calls but does not answer them",
    "killed": "the device server ends; the card continues",
    "watchdog_expired": "the card's watchdog opens every relay as if it had not been fed",
    "value_out_of_range": "the card refuses what is written to its outputs (-200077)",
    "relay_stuck": "the contacts of the relay that closed first stay closed",
    "sensor_dead": "the first sensor reads 0 V",
    "sensors_saturated": "every sensor reads its upper limit",
    "outputs_frozen": "outputs and lines keep their values, as when the host computer crashes",
    "button": "the operator's button is pressed",
    "serial_unplugged": "the magnet stage's cable is pulled",
    "serial_garbled": "a line to or from the magnet stage arrives garbled",
    "serial_truncated": "a line to or from the magnet stage arrives cut short",
    "firmware_reset": "the magnet stage's controller resets",
    "firmware_hung": "the magnet stage's main loop hangs",
}

_KINDS = {name: FaultKind(about) for name, about in FAULTS.items()}


def parse_fault(text: str) -> InjectedFault:
    """Parse a fault of the twin; see `sim.tank.faults.parse_fault`. Unless the text says otherwise, it occurs once.

    Parameters
    ----------
    text : str

    Returns
    -------
    InjectedFault

    Raises
    ------
    InputError
        If name, moment or duration are unknown.

    Examples
    --------
    >>> fault = parse_fault("overrun@actuation#30:good")
    >>> fault.name, fault.phase, fault.shot
    ('overrun', 'actuation', 30)
    >>> parse_fault("button@12.5s").seconds
    12.5
    """
    return parse_named_fault(text, _KINDS)


class FaultInjector:
    """Holds pending and present faults. Safe from any thread.

    Parameters
    ----------
    on_fault : callable
        Called with the name of each fault as it occurs; it must not block, unlike listeners (see `add_listener`).
    clock : callable
        Returns the time in s.
    """

    def __init__(self, on_fault: Callable[[str], None], clock: Callable[[], float] = time.monotonic) -> None:
        self._on_fault, self._clock = on_fault, clock
        self._listeners: list[Callable[[str], None]] = []
        self._lock = threading.Lock()
        self._pending: list[InjectedFault] = []
        self._active: dict[str, tuple[float, float]] = {}  # duration and start, in s
        self._first_shot: float | None = None

    def add_listener(self, listener: Callable[[str], None]) -> None:
        """Call a listener with the name of each fault as it occurs, in a thread of its own.

        Parameters
        ----------
        listener : callable
        """
        self._listeners.append(listener)

    def add(self, fault: InjectedFault) -> None:
        """Add a pending fault, or let it occur now.

        Parameters
        ----------
        fault : InjectedFault
        """
        with self._lock:
            if fault.phase or fault.seconds is not None:
                self._pending.append(fault)
                return
        self._activate(fault)

    def clear(self) -> None:
        """Remove all faults, present and pending."""
        with self._lock:
            self._pending.clear()
            self._active.clear()

    def forget_first_shot(self) -> None:
        """Forget the first shot: a new client has opened the card."""
        self._first_shot = None

    def notify_phase(self, phase: str, shot: int) -> None:
        """Notify that the card has reached a phase of a shot.

        Parameters
        ----------
        phase : {"before", "actuation", "listening"}
        shot : int
            Number of the electrical shot, from 1.
        """
        if phase == "actuation" and self._first_shot is None:
            self._first_shot = self._clock()
        with self._lock:
            due = [f for f in self._pending if f.phase == phase and f.shot == shot]
            self._pending = [f for f in self._pending if f not in due]
        for fault in due:
            self._activate(fault)

    def activate_due(self) -> None:
        """Activate the faults whose time has come."""
        if self._first_shot is None or not self._pending:
            return
        since = self._clock() - self._first_shot
        with self._lock:
            due = [f for f in self._pending if f.seconds is not None and since >= f.seconds]
            self._pending = [f for f in self._pending if f not in due]
        for fault in due:
            self._activate(fault)

    def _activate(self, fault: InjectedFault) -> None:
        with self._lock:
            duration = ONCE if fault.duration is None else fault.duration
            self._active[fault.name] = (duration, self._clock())
        self._on_fault(fault.name)
        for listener in self._listeners:
            threading.Thread(target=listener, args=(fault.name,), name=f"fault {fault.name}", daemon=True).start()

    def take(self, name: str) -> bool:
        """Return whether an event such as a time-out is due; one that occurs once is then removed.

        Parameters
        ----------
        name : str

        Returns
        -------
        bool
        """
        if name not in self._active:
            return False
        with self._lock:
            found = self._active.get(name)
            if found is None:
                return False
            duration, began = found
            over = self._clock() - began > duration
            if over or duration == ONCE:
                del self._active[name]
            return duration == ONCE or not over

    def is_permanent(self, name: str) -> bool:
        """Return whether a present fault is permanent.

        Parameters
        ----------
        name : str

        Returns
        -------
        bool
        """
        return self._active.get(name, (ONCE, 0.0))[0] == GOOD

    def is_active(self, name: str) -> bool:
        """Return whether a state such as a dead sensor is present.

        Parameters
        ----------
        name : str

        Returns
        -------
        bool
        """
        found = self._active.get(name)
        if found is None:
            return False
        duration, began = found
        if self._clock() - began > (STATE_DURATION if duration == ONCE else duration):
            with self._lock:
                self._active.pop(name, None)
            return False
        return True
