"""Previews a mission in a process of its own: computing here would keep a STOP waiting."""

from __future__ import annotations

import html
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from typing import Any

LONGEST = 120.0
"""Seconds that a preview may take."""


def preview(arguments: Sequence[str]) -> tuple[bool, str]:
    """Whether to go, and what ``smolbot preview`` says, as HTML.

    Parameters
    ----------
    arguments : sequence of str
        Of the command: the mission, and options.
    """
    command = [sys.executable, "-P", "-m", "smolbot", "preview", *arguments, "--json"]
    if os.name == "posix":
        command = ["nice", *command]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST, check=False)
    except subprocess.TimeoutExpired:
        return False, told(False, [f"The preview took longer than {LONGEST:g} s."], [])
    try:
        seen: dict[str, Any] = json.loads(done.stdout)
    except ValueError:
        return False, told(False, done.stderr.strip().splitlines()[-12:], [])
    return bool(seen["go"]), told(bool(seen["go"]), seen.get("reasons", []), rows_of(seen))


def rows_of(seen: dict[str, Any]) -> list[tuple[str, str]]:
    """What a person wants to know first; what a kind of mission does not say is left out."""
    found: list[tuple[str, str]] = []

    def add(name: str, key: str, form: str) -> None:
        value = seen.get(key)
        if isinstance(value, int | float):
            found.append((name, form.format(value)))
        elif isinstance(value, dict):
            ends = [form.format(value[end]) for end in ("min", "max") if isinstance(value.get(end), int | float)]
            found.append((name, " to ".join(ends)))

    add("path", "path_length_mm", "{:.1f} mm")
    add("expected to take", "expected_duration_s", "{:.0f} s")
    add("loop rate", "loop_rate_hz", "{:.1f} a second")
    add("force", "force_un", "{:.0f} µN")
    add("error of a pose", "localization_error_mm", "{:.2f} mm")
    add("pauses", "pauses", "{:d}")
    add("torque to spare", "torque_margin", "{:.2f}")
    return found


def told(go: bool, reasons: Sequence[str], rows: Sequence[tuple[str, str]]) -> str:
    """Go or no-go, why, and figures, as HTML."""
    colour, word = ("#15803d", "GO") if go else ("#dc2626", "NO-GO")
    why = "".join(f"<div>{html.escape(reason)}</div>" for reason in reasons)
    cells = "".join(
        f'<tr><td style="color:#64748b;padding-right:10px">{n}</td><td>{html.escape(t)}</td></tr>' for n, t in rows
    )
    return (
        f'<div style="margin:4px 12px;font-size:13px"><b style="color:{colour};font-size:18px">{word}</b>{why}'
        f'<table style="border-spacing:0">{cells}</table></div>'
    )


def waiting(words: str) -> str:
    """That something is being done, as HTML."""
    return f'<div style="margin:4px 12px;font-size:13px;color:#64748b">{html.escape(words)}</div>'
