"""Preview of a mission in a process of its own: computing in this process would delay a STOP."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from smolbot.core.markup import load_template

TEMPLATE = Path(__file__).with_name("panels.html")

PREVIEW_TIMEOUT = 120.0
"""Time limit of a preview, in s."""


def preview(arguments: Sequence[str]) -> tuple[bool, str]:
    """Run ``smolbot preview`` and format its result as HTML.

    Parameters
    ----------
    arguments : sequence of str
        Of the command: the mission, and options.

    Returns
    -------
    go : bool
    html : str
    """
    command = [sys.executable, "-P", "-m", "smolbot", "preview", *arguments, "--json"]
    if os.name == "posix":
        command = ["nice", *command]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=PREVIEW_TIMEOUT, check=False)
    except subprocess.TimeoutExpired:
        return False, panel("verdict", False, [f"The preview took longer than {PREVIEW_TIMEOUT:g} s."])
    try:
        found: dict[str, Any] = json.loads(done.stdout)
    except ValueError:
        return False, panel("verdict", False, done.stderr.strip().splitlines()[-12:])
    return bool(found["go"]), panel("verdict", found["go"], found.get("reasons", []), select_rows(found))


def select_rows(found_preview: dict[str, Any]) -> list[tuple[str, str]]:
    """Select the most important figures of a preview; those that it lacks are left out.

    Parameters
    ----------
    found_preview : dict
        JSON output of ``smolbot preview``.

    Returns
    -------
    list of (str, str)
        Name and value with unit.
    """
    found: list[tuple[str, str]] = []

    def add(name: str, key: str, form: str) -> None:
        value = found_preview.get(key)
        if isinstance(value, int | float):
            found.append((name, form.format(value)))
        elif isinstance(value, dict):
            ends = [form.format(value[end]) for end in ("min", "max") if isinstance(value.get(end), int | float)]
            found.append((name, " to ".join(ends)))

    add("path", "path_length_mm", "{:.1f} mm")
    add("expected to take", "expected_duration_s", "{:.0f} s")
    add("loop rate", "loop_rate_hz", "{:.1f} Hz")
    add("force", "force_un", "{:.3g} µN")
    add("error of a pose", "localization_error_mm", "{:.2f} mm")
    add("pauses", "pauses", "{:d}")
    add("torque to spare", "torque_margin", "{:.2f}")
    return found


def panel(kind: str, *data: object) -> str:
    """Format the text of a panel as HTML.

    Parameters
    ----------
    kind : str
        A macro of ``panels.html``.
    *data
        What it takes.

    Returns
    -------
    str
        A plain one: a page in the browser takes no other.
    """
    return str(getattr(load_template(TEMPLATE).module, kind)(*data))
