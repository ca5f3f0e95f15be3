"""A little more of the machine for what must answer in time."""

from __future__ import annotations

import contextlib
import os

WANTED = -10
"""Niceness: above all that people usually run, below what the machine itself needs."""


def ask_for_priority() -> bool:
    """Let this process go first where that is allowed; say whether it is.

    Without the right to (on Linux: ``CAP_SYS_NICE``, or a limit for ``nice``) nothing changes.
    """
    if not hasattr(os, "setpriority"):
        return False
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, min(WANTED, os.getpriority(os.PRIO_PROCESS, 0)))
        return True
    return False
