"""Settings that override a mission's files, from a call's keywords."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from smolbot.config.document import format_setting

DEFAULT_ROBOT = "gradient"
"""Robot that is used if none is named."""


def merge_settings(settings: Mapping[str, str] | None, overrides: Mapping[str, Any]) -> dict[str, str]:
    """Merge settings in the form of files with those from keywords of a call.

    Parameters
    ----------
    settings : mapping of str to str, optional
        ``{"controller.tolerance_mm": "0.5"}``, values as TOML writes them.
    overrides : mapping of str to object
        Keywords, with ``__`` for the dot; they take precedence.

    Returns
    -------
    dict of str to str

    Examples
    --------
    >>> merge_settings(None, {"controller__tolerance_mm": 0.5, "path__glyph": "S"})
    {'controller.tolerance_mm': '0.5', 'path.glyph': 'S'}
    """
    spelled = {name.replace("__", "."): format_setting(value) for name, value in overrides.items()}
    return {**(settings or {}), **spelled}
