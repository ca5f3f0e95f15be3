"""How long a thread may keep the other threads of its process waiting."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

SWITCH_INTERVAL = 0.5e-3
"""Time, in s, after which a computing thread yields to a waiting one; Python's 5 ms is too long for a watchdog."""


@contextmanager
def shorten_switch_interval() -> Iterator[None]:
    """Shorten the switch interval of this process's threads while the block runs: loop, watchdog, recorder, STOP.

    Yields
    ------
    None
    """
    before = sys.getswitchinterval()
    sys.setswitchinterval(min(SWITCH_INTERVAL, before))
    try:
        yield
    finally:
        sys.setswitchinterval(before)
