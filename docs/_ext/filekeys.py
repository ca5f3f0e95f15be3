"""Write tables of the keys of a user's file, as Markdown, from the models that check it.

As a Sphinx extension it only registers the place of each model's table, so that the API reference links
there.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from numpydoc.docscrape import NumpyDocString

import smolbot
from smolbot.config.document import _find_inner_model

UNITS = {
    "mm": "mm", "ms": "ms", "s": "s", "a": "A", "hz": "Hz", "deg": "°", "percent": "%", "mm_s": "mm/s",
    "mm_s2": "mm/s²", "deg_s": "°/s", "deg_per_s": "°/s", "per_s": "1/s", "t": "T", "mt": "mT", "ut": "µT", "nt": "nT",
    "nt_per_s": "nT/s", "nt_per_m": "nT/m", "pt_per_rthz": "pT/√Hz", "v": "V", "v_per_ut": "V/µT", "a_per_v": "A/V",
    "c": "°C", "ohm": "Ω", "pa_s": "Pa s", "pa": "Pa", "kg_m3": "kg/m³", "ma_m2": "mA m²", "mg": "mg",
    "j_per_k": "J/K", "k_per_w": "K/W", "n_per_m2": "N/m²", "n_per_m": "N/m", "baud": "Bd",
}  # fmt: skip

COLUMNS = ("key", "unit", "value", "default", "meaning")


def find_unit(key: str) -> str:
    """Find the unit that the end of a key names.

    Parameters
    ----------
    key : str

    Returns
    -------
    str
        Empty if there is none.
    """
    parts = key.split("_")
    for start in range(1, len(parts)):
        if (unit := UNITS.get("_".join(parts[start:]))) is not None:
            return unit
    return UNITS.get(key, "") if key == "baud" else ""


class Schema:
    """JSON schema of a model, with the definitions that it refers to.

    Parameters
    ----------
    model : pydantic model class
    """

    def __init__(self, model: Any) -> None:
        self.root: dict[str, Any] = model.model_json_schema()
        self._defined: dict[str, Any] = self.root.get("$defs", {})

    def resolve(self, part: dict[str, Any]) -> dict[str, Any]:
        """Follow the reference of a part, and remove the alternative "null".

        Parameters
        ----------
        part : dict

        Returns
        -------
        dict
        """
        part = dict(part)
        options = [option for option in part.get("anyOf", ()) if option.get("type") != "null"]
        if len(options) == 1:
            part = {**part, **options[0]}
            part.pop("anyOf")
        if "$ref" in part:
            part = {**self._defined[part.pop("$ref").rsplit("/", 1)[1]], **part}
        return part

    def find_section(self, part: dict[str, Any]) -> tuple[dict[str, Any], bool] | None:
        """Find the section that a part describes.

        Parameters
        ----------
        part : dict

        Returns
        -------
        tuple or None
            The section, and whether it may be repeated; None for a plain key.
        """
        part = self.resolve(part)
        if "properties" in part:
            return part, False
        if part.get("type") == "array" and isinstance(part.get("items"), dict):
            inner = self.resolve(part["items"])
            if "properties" in inner:
                return inner, True
        return None

    def describe_value(self, part: dict[str, Any]) -> str:
        """Describe the permitted values of a part in words.

        Parameters
        ----------
        part : dict

        Returns
        -------
        str
        """
        part = self.resolve(part)
        if "anyOf" in part:
            return " or ".join(dict.fromkeys(self.describe_value(option) for option in part["anyOf"]))
        if "const" in part:
            return f"{part['const']!r}".replace("'", '"')
        if "enum" in part:
            return ", ".join(f"{item!r}" for item in part["enum"]).replace("'", '"')
        kind = part.get("type")
        if kind == "array":
            return self._array(part)
        if kind == "object":
            values = part.get("additionalProperties")
            return "a table" + (f" of {self.describe_value(values)}" if isinstance(values, dict) else "")
        name = {"number": "number", "integer": "whole number", "boolean": "true or false", "string": "text"}
        return (name.get(str(kind), str(kind)) + _limits(part)).strip()

    def _array(self, part: dict[str, Any]) -> str:
        if "prefixItems" in part:
            each = [self.describe_value(item) for item in part["prefixItems"]]
            return f"{len(each)} × {each[0]}" if len(set(each)) == 1 else f"[{', '.join(each)}]"
        least = part.get("minItems", 0)
        return f"list of {self.describe_value(part['items'])}" + (f", at least {least}" if least else "")


def _limits(part: dict[str, Any]) -> str:
    low, above = part.get("minimum"), part.get("exclusiveMinimum")
    high, below = part.get("maximum"), part.get("exclusiveMaximum")
    limits = [
        f"{sign} {limit:g}"
        for sign, limit in (("≥", low), (">", above), ("≤", high), ("<", below))
        if limit is not None
    ]
    return " " + ", ".join(limits) if limits else ""


def _models(model: Any) -> list[Any]:
    """The model and those of its sections."""
    found = [model]
    for info in model.model_fields.values():
        inner = _find_inner_model(info.annotation)
        if inner is not None:
            found += _models(inner)
    return found


class Example:
    """Values and comments of a TOML file by section and key.

    Parameters
    ----------
    text : str
        The file.
    """

    _HEADER = re.compile(r"^\[+([^\]]+)\]+")
    _KEY = re.compile(r"^([a-z0-9_]+) = (.+?)(?:\s{2,}# (.*))?$")

    def __init__(self, text: str) -> None:
        self.held: dict[tuple[str, str], tuple[str, str]] = {}
        section = ""
        for line in text.splitlines():
            if header := self._HEADER.match(line):
                section = header[1]
            elif key := self._KEY.match(line):
                self.held.setdefault((section, key[1]), (key[2], key[3] or ""))

    def find(self, section: str, key: str) -> str:
        """Find ``value: comment`` of a key.

        Parameters
        ----------
        section, key : str

        Returns
        -------
        str
            Empty if the file has none, or a long one.
        """
        value, comment = self.held.get((section, key), ("", ""))
        if not value or len(value) > 40 or value in ("[", "{"):
            return ""
        return f"{value}: {comment}" if comment else value


def write_tables(model: str, example: str = "", section: str = "") -> str:
    """Tables of a model's keys as Markdown: one for each section, under its name.

    Parameters
    ----------
    model : str
        ``"smolbot.config.mission:MissionFile"``.
    example : str
        A file of the package whose values and comments are shown beside the keys: ``"missions/r_path.toml"``.
    section : str
        Section of the file that the model describes, in front of the names of its own sections.

    Returns
    -------
    str
        Markdown.
    """
    module, name = model.split(":")
    found = getattr(import_module(module), name)
    homes = {inner.__name__: f"{inner.__module__}.{inner.__name__}" for inner in _models(found)}
    path = Path(str(smolbot.__file__)).parent / example
    shown = Example(path.read_text(encoding="utf-8")) if path.is_file() else Example("")
    schema = Schema(found)
    return "\n\n".join(_tables(schema, schema.root, section, False, shown, path.name, homes))


def _tables(
    schema: Schema, part: dict[str, Any], title: str, many: bool, example: Example, source: str, homes: dict[str, str]
) -> Iterator[str]:
    """Elements of one section, then those of the sections in it."""
    text = NumpyDocString(part.get("description", ""))
    meanings = {key.strip(): " ".join(item.desc) for item in text["Attributes"] for key in item.name.split(",")}
    anchor = f'<a id="{home}"></a>' if (home := homes.get(part.get("title", ""))) else ""
    if title:
        yield f"{anchor}**`[[{title}]]`**" if many else f"{anchor}**`[{title}]`**"
    elif anchor:
        yield anchor
    for paragraph in [" ".join(text["Summary"]), *" ".join(text["Extended Summary"]).split("  ")]:
        if paragraph.strip():
            yield to_markdown(paragraph)
    rows, inner = [], []
    for key, property_ in part["properties"].items():
        section = schema.find_section(property_)
        if section is not None:
            inner.append((key, *section))
            continue
        default = property_.get("default")
        needed = key in part.get("required", ())
        shown = "needed" if needed else ("" if default is None else f"`{_toml(default)}`")
        parts = [meanings.get(key, "")]
        if given := example.find(title, key):
            parts.append(f"{source}: {given}")
        meaning = to_markdown(". ".join(s.rstrip(".") for s in parts if s))
        rows.append((f"`{key}`", find_unit(key), schema.describe_value(property_), shown, meaning))
    if rows:
        yield write_table(COLUMNS, rows)
    for key, section_part, several in inner:
        below = f"{title}.{key}" if title else key
        yield from _tables(schema, section_part, below, several, example, source, homes)


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else f"{value}"


def to_markdown(text: str) -> str:
    """Convert the text of a docstring or of a help to Markdown that shows it unchanged.

    Parameters
    ----------
    text : str

    Returns
    -------
    str
    """
    return text.replace("``", "`").replace("<", "&lt;")


def write_table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Write a Markdown table.

    Parameters
    ----------
    columns : sequence of str
    rows : iterable of sequence of str
        Cells in Markdown, without line breaks.

    Returns
    -------
    str
    """
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def _note_models(app: Any, page: str, source: list[str]) -> None:
    """Register the table of each model as the target of its name."""
    domain = app.env.get_domain("py")
    for name in re.findall(r'<a id="([\w.]+\.\w+)"></a>', source[0]):
        if name not in domain.objects:
            domain.note_object(name, "class", name)


def setup(app: Any) -> dict[str, Any]:
    """Register the extension in Sphinx.

    Parameters
    ----------
    app : Sphinx

    Returns
    -------
    dict
    """
    app.connect("source-read", _note_models)
    return {"version": "2", "parallel_read_safe": True}
