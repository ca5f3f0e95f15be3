"""The reference is made from the code, and leaves nothing public out."""

from __future__ import annotations

import importlib
import re
import sys
from pathlib import Path
from typing import Annotated

import pytest
from pydantic import Field

import controllers
import lookup_tables
import smolbot
from smolbot.config.document import FileModel

DOCS = Path(__file__).parents[2] / "docs"
sys.path.insert(0, str(DOCS / "_ext"))

pytest.importorskip("sphinx", reason="needs the extra docs")
commandline, filekeys, mathml = (importlib.import_module(name) for name in ("commandline", "filekeys", "mathml"))


@pytest.mark.parametrize("package", [smolbot, lookup_tables, controllers], ids=lambda p: p.__name__)
def test_every_public_name_is_in_the_reference(package):
    listed = {line.strip() for line in (DOCS / "reference" / "api.rst").read_text().splitlines()}
    assert not {name for name in package.__all__ if not name.startswith("__")} - listed


def test_the_top_has_few_names_and_an_example_for_each():
    assert len(smolbot.__all__) <= 45
    without = [name for name in smolbot.__all__ if ">>>" not in str(getattr(smolbot, name).__doc__)]
    assert without == ["__version__"]


def test_no_path_in_the_reference_or_the_tutorials_is_deeper_than_one_package():
    pages = [DOCS / "reference" / "api.rst", *(DOCS / "tutorials").glob("*.md"), DOCS.parent / "README.md"]
    pages += (DOCS.parent / "examples").glob("*.py")
    package = r"(smolbot|sim|controllers|lookup_tables)"
    deep = rf"(?:from|import|currentmodule::|py:\w+::)\s+({package}(?:\.[a-z_]+){{2,}})\b"
    assert [found[1] for page in pages for found in re.finditer(deep, page.read_text(encoding="utf-8"))] == []


class Inner(FileModel):
    """Of an inner section."""

    turns: Annotated[int, Field(ge=2, le=9)]


class Outer(FileModel):
    """A section."""

    speed_mm_s: Annotated[float, Field(gt=0)] = 1.5
    law: str | None = None
    inner: list[Inner] = Field(default_factory=list)


def test_limits_units_and_sections_are_those_of_the_model():
    schema = filekeys.Schema(Outer)
    keys = schema.root["properties"]
    assert filekeys.find_unit("speed_mm_s") == "mm/s"
    assert schema.describe_value(keys["speed_mm_s"]) == "number > 0"
    assert schema.describe_value(keys["law"]) == "text"
    assert schema.find_section(keys["law"]) is None
    inner, several = schema.find_section(keys["inner"])
    assert several
    assert schema.describe_value(inner["properties"]["turns"]) == "whole number ≥ 2, ≤ 9"


@pytest.mark.parametrize("page", ["missions/r_path.toml", "rigs/tank.toml", "rigs/bench.toml", "robots/gradient.toml"])
def test_units_of_shipped_files_are_all_known(page):
    """A key that ends like a unit has one; others are counts, names and shares."""
    example = filekeys.Example((Path(smolbot.__file__).parent / page).read_text(encoding="utf-8"))
    bare = {key for _, key in example.held if not filekeys.find_unit(key)}
    assert not [key for key in bare if key.rsplit("_", 1)[-1] in ("mm", "ms", "hz", "deg", "percent", "ohm")]


def test_every_command_has_its_section():
    root = commandline.make_root_command()
    names = set(root.list_commands(root.context_class(root, info_name="smolbot")))
    assert {"run", "preview", "check", "simulate", "tune", "localize", "twin", "table", "study"} <= names
