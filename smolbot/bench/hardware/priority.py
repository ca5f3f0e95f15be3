"""A higher scheduling priority for the process that must answer in time."""

from __future__ import annotations

import contextlib
import os

NICENESS = -10
"""Niceness: above usual programs, below what the machine itself needs."""


def raise_priority() -> bool:
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
        os.setpriority(os.PRIO_PROCESS, 0, min(NICENESS, os.getpriority(os.PRIO_PROCESS, 0)))
        return True
    return False
