"""Cost of a flight: tracking error, duration, and whether the path's end was reached."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

COST_PER_PACE = 0.05
"""Worth of a second per millimetre of path, in mm of tracking error."""

MISSED_COST = 5.0
"""Cost, in mm, of a flight that does not reach the end; as much again for the path that was left."""

REFUSED_COST = 2.0 * MISSED_COST
"""Cost, in mm, of gains that the law refuses."""

FAILED_COST = 1.0
"""Cost, in mm, of a flight that reaches the end but fails the mission's verdict."""


def compute_cost(summary: Mapping[str, Any]) -> float:
    """Compute the cost of one flight in mm, from its summary: the lower, the better.

    Tracking error (rms, in mm) plus `PACE` times the seconds that a millimetre of path took. A flight that does
    not reach the end costs more than any that does.

    Parameters
    ----------
    summary : mapping
        As ``summary.json`` has it.

    Returns
    -------
    float, in mm

    Examples
    --------
    >>> flown = {"status": "completed", "verdict": "passed", "duration_s": 80.0, "path_length_mm": 40.0}
    >>> round(compute_cost({**flown, "tracking_error_mm": {"rms": 0.4}}), 3)
    0.5
    >>> compute_cost({"status": "timeout", "path_length_mm": 40.0, "progress_mm": 10.0})
    8.75
    """
    length = float(summary["path_length_mm"])
    if summary["status"] != "completed":
        left = 1.0 - min(float(summary.get("progress_mm") or 0.0) / length, 1.0)
        return MISSED_COST * (1.0 + left)
    error = float(summary["tracking_error_mm"]["rms"])
    off = min(error + COST_PER_PACE * float(summary["duration_s"]) / length, MISSED_COST - FAILED_COST)
    return off + (0.0 if summary["verdict"] == "passed" else FAILED_COST)
