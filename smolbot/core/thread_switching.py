"""How long a thread may keep the others of its process waiting."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

TURN = 0.5e-3
"""Seconds after which a thread that computes lets one go on that waits; Python's own 5 ms are long for a watchdog."""


@contextmanager
def short_turns() -> Iterator[None]:
    """While the block runs, threads of this process take short turns: loop, watchdog, recorder, STOP."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(min(TURN, before))
    try:
        yield
    finally:
        sys.setswitchinterval(before)
