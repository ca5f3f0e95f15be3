"""Ctrl-C and SIGTERM end a run once; the shutdown that follows is not interrupted."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from smolbot.flight.safety.stop_latch import Latch

CTRL_C_REASON = "stopped by the operator (Ctrl-C)"
SIGTERM_REASON = "stopped by a signal (SIGTERM)"


@contextmanager
def catch_stop_signals(latch: Latch) -> Iterator[None]:
    """Turn the first SIGINT or SIGTERM within a ``with`` block into a ``KeyboardInterrupt`` with its reason.

    Further signals raise nothing, nor does any signal once the run is over. Python delivers signals to the main
    thread only; in any other thread, the block runs unchanged.

    Parameters
    ----------
    latch : Latch
        Tripped by the signal.

    Raises
    ------
    KeyboardInterrupt
        On the first signal.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    raised = False

    def interrupt(number: int, _: FrameType | None) -> None:
        nonlocal raised
        if latch.over or raised:
            os.write(2, b"already stopping: outputs go to zero and the run folder is written\n")
            return
        raised = True
        reason = SIGTERM_REASON if number == signal.SIGTERM else CTRL_C_REASON
        latch.trip(reason, "stopped", halt=False)  # the signal may have interrupted a halt: the caller halts
        raise KeyboardInterrupt(reason)

    before = {number: signal.signal(number, interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
