"""The log of the twin's card, on the monotonic clock: when outputs were driven, relays closed, and faults occurred."""

from __future__ import annotations

import itertools
import threading
import time
from collections import deque
from typing import Any

import numpy as np

from smolbot.core.arrays import BoolArray, FloatArray

MAX_ENTRIES = 50_000
"""Entries that are kept; each shot of a mission adds about ten."""

MIN_DRIVEN_CURRENT = 1e-6
"""Commanded current, in A, above which a load is driven: far below one step of a 16-bit converter."""

MAX_ZERO_CROSSING = 1e-3
"""Time at zero, in s, after which a load is no longer driven: a sine passes through zero."""


class Journal:
    """A log. Safe from any thread.

    An entry is a mapping with ``number``, ``time`` (s, monotonic clock), ``what``, and details.
    """

    def __init__(self) -> None:
        self._entries: deque[dict[str, Any]] = deque(maxlen=MAX_ENTRIES)
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()

    def add(self, what: str, at: float | None = None, **detail: Any) -> None:
        """Add an entry.

        Parameters
        ----------
        what : str
        at : float, in s, optional
            Time of the entry; now if not given.
        **detail : Any
            Further values.
        """
        stamp = time.monotonic() if at is None else at
        with self._lock:
            self._entries.append({"number": next(self._numbers), "time": stamp, "what": what, **detail})

    def list_since(self, number: int = 0) -> list[dict[str, Any]]:
        """Return the entries after a number, in the order of writing.

        Parameters
        ----------
        number : int

        Returns
        -------
        list of dict
        """
        with self._lock:
            return [entry for entry in self._entries if entry["number"] > number]


class OnOffMonitor:
    """Monitors whether something is on, sample by sample, and logs each change.

    Parameters
    ----------
    journal : Journal
    what : str
        Name of the entries.
    pause : int
        Number of samples that it must be off to count as off; it is off from the first of them.

    Attributes
    ----------
    on : bool
    latest : float, in s
        When it was last on, on the monotonic clock; 0 if never.
    """

    def __init__(self, journal: Journal, what: str, pause: int = 0) -> None:
        self._journal, self._what, self._pause = journal, what, pause
        self.on, self.latest = False, 0.0
        self._latest_sample = -1

    def update(self, first: int, levels: BoolArray, epoch: float, rate: float) -> None:
        """Update from the levels of consecutive samples.

        Parameters
        ----------
        first : int
            Index of the first sample.
        levels : ndarray of bool, shape (n,)
        epoch : float, in s
            Time of sample 0.
        rate : float, in Hz
        """
        n = len(levels)
        if not levels.any():
            self._switch_off(first + n, epoch, rate)
            return
        ons = first + np.flatnonzero(levels)
        if levels.all() and self.on:  # nothing changed
            self._latest_sample = int(ons[-1])
        else:
            self._log_changes(ons, epoch, rate)
            self._switch_off(first + n, epoch, rate)
        self.latest = epoch + (int(ons[-1]) + 1) / rate

    def _log_changes(self, ons: Any, epoch: float, rate: float) -> None:
        breaks = np.flatnonzero(np.diff(ons) > self._pause + 1)
        for begin, end in zip(np.concatenate([[0], breaks + 1]), np.concatenate([breaks, [len(ons) - 1]]), strict=True):
            self._switch_off(int(ons[begin]), epoch, rate)
            if not self.on:
                self.on = True
                self._journal.add(self._what, epoch + int(ons[begin]) / rate, on=True)
            self._latest_sample = int(ons[end])

    def _switch_off(self, reached: int, epoch: float, rate: float) -> None:
        if self.on and reached - (self._latest_sample + 1) > self._pause:
            self.on = False
            self._journal.add(self._what, epoch + (self._latest_sample + 1) / rate, on=False)


class OutputMonitor:
    """Monitors the commanded currents (``driven``), the relays (``closed``) and the amplifiers (``enabled``).

    Parameters
    ----------
    journal : Journal
    rate : float, in Hz
        Of the samples.

    Attributes
    ----------
    driven, closed, enabled : Line
    """

    def __init__(self, journal: Journal, rate: float) -> None:
        self._rate = rate
        self.driven = OnOffMonitor(journal, "driven", round(MAX_ZERO_CROSSING * rate))
        self.closed, self.enabled = OnOffMonitor(journal, "closed"), OnOffMonitor(journal, "enabled")

    def update(self, first: int, epoch: float, currents: FloatArray, contacts: BoolArray, enabled: BoolArray) -> None:
        """Update from consecutive samples.

        Parameters
        ----------
        first : int
            Index of the first sample.
        epoch : float, in s
            Time of sample 0.
        currents : ndarray, shape (n_loads, n), in A
            As commanded.
        contacts : ndarray of bool, shape (n_relays, n)
            Whether closed.
        enabled : ndarray of bool, shape (n,)
        """
        self.driven.update(first, np.abs(currents).max(axis=0) > MIN_DRIVEN_CURRENT, epoch, self._rate)
        self.closed.update(first, np.logical_or.reduce(contacts, axis=0), epoch, self._rate)
        self.enabled.update(first, enabled, epoch, self._rate)
