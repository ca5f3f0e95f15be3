"""A higher scheduling priority for the process that must answer in time."""

from __future__ import annotations

import contextlib
import os

WANTED = -10
"""Niceness: above usual programs, below what the machine itself needs."""


def ask_for_priority() -> bool:
    """Raise the scheduling priority of this process, where that is allowed.

    Without permission (on Linux: ``CAP_SYS_NICE``, or a limit for ``nice``) nothing changes.

    Returns
    -------
    bool
        Whether it was raised.
    """
    if not hasattr(os, "setpriority"):
        return False
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, min(WANTED, os.getpriority(os.PRIO_PROCESS, 0)))
        return True
    return False
