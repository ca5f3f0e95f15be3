"""Settings as TOML text."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

from smolbot.config.document import Document


def as_used(document: Document) -> str:
    """Text of a file with its settings applied; the user's own text where nothing was set."""
    return document.text if not document.settings else f"# as used, with settings applied\n{toml_text(document.data)}"


def toml_text(data: Mapping[str, Any], prefix: str = "") -> str:
    """TOML of nested dictionaries, lists, text, numbers and truth values.

    Examples
    --------
    >>> print(toml_text({"a": 1.5, "t": {"b": [1, 2], "c": "x"}}))
    a = 1.5
    <BLANKLINE>
    [t]
    b = [1, 2]
    c = "x"
    <BLANKLINE>
    """
    lines = [f"{_key(k)} = {_value(v)}" for k, v in data.items() if not _is_table(v)]
    text = "\n".join(lines) + "\n" if lines else ""
    for key, value in data.items():
        name = f"{prefix}{_key(key)}"
        if isinstance(value, dict):
            text += f"\n[{name}]\n{toml_text(value, name + '.')}"
        elif _is_table(value):
            text += "".join(f"\n[[{name}]]\n{toml_text(item, name + '.')}" for item in value)
    return text


def _is_table(value: Any) -> bool:
    return isinstance(value, dict) or (
        isinstance(value, list) and bool(value) and all(isinstance(v, dict) for v in value)
    )


def _key(key: str) -> str:
    return key if key.replace("_", "").replace("-", "").isalnum() else json.dumps(key)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, list):
        return "[" + ", ".join(_value(v) for v in value) + "]"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items()) + " }"
    return json.dumps(value, ensure_ascii=False)
