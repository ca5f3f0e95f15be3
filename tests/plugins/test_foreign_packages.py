"""Packages of a lab, installed beside smolbot: every part of theirs is found, checked and flown, or refused by name."""

from __future__ import annotations

import ast
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from importlib import import_module
from pathlib import Path

import pytest

from smolbot.config import plugins
from smolbot.config.library import list_shipped, open_file
from smolbot.config.load import load_mission
from smolbot.config.rig import load_rig
from smolbot.errors import ConfigError, PluginError

HERE = Path(__file__).parent
LAB, OWN_WORLD, HELICAL_LAW = HERE / "lab", HERE / "own_world", HERE / "helical_law"
OURS = ("smolbot", "controllers", "lookup_tables", "sim")
PROJECT = tomllib.loads((LAB / "pyproject.toml").read_text())
REFERENCE = HERE.parents[1] / "docs/reference/api.rst"

BRIEF = ("--set", "stop.max_duration_s=1", "--set", "localization.quiet_s=0", "--no-report", "--json")

RIG = """
extends = "tank"
name = "tank"
world = "bath"
[bath]
address = "10.0.0.7"
"""

ALL_PLACES = str(open_file("tank", "rigs").data["sensors"]["positions_mm"])
TRIAXIAL = """
extends = "tank"
name = "cubes"
[sensors]
kind = "triaxial"
places_mm = ALL_PLACES
""".replace("ALL_PLACES", ALL_PLACES)

MISSION = """
extends = "line"
name = "spiral"
[path]
file = "spiral.polar"
"""


@pytest.fixture(scope="session")
def installed(tmp_path_factory) -> Path:
    """Folder with the lab's package as an installer leaves it: the modules, and what pyproject.toml says of them."""
    target = tmp_path_factory.mktemp("installed")
    shutil.copytree(LAB / "lab_parts", target / "lab_parts", ignore=shutil.ignore_patterns("__pycache__"))
    project = PROJECT["project"]
    about = target / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    groups = (
        "\n".join([f"[{group}]", *(f"{name} = {value}" for name, value in points.items()), ""])
        for group, points in project["entry-points"].items()
    )
    (about / "entry_points.txt").write_text("\n".join(groups))
    return target


@pytest.fixture
def lab(installed, monkeypatch):
    """The lab's package, installed in this process."""
    monkeypatch.syspath_prepend(str(installed))
    plugins._find_entry_points.cache_clear()
    yield installed
    plugins._find_entry_points.cache_clear()
    for module in [name for name in sys.modules if name.partition(".")[0] == "lab_parts"]:
        del sys.modules[module]


@pytest.fixture
def files(tmp_path) -> Path:
    """A folder with a lab's own rigs, mission and path."""
    for name, text in (("bath.toml", RIG), ("cubes.toml", TRIAXIAL), ("spiral.toml", MISSION)):
        (tmp_path / name).write_text(text)
    (tmp_path / "spiral.polar").write_text("2 0\n4 20\n6 40\n")
    return tmp_path


def smolbot(where: Path, cwd: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a command of smolbot with what is installed in a folder besides."""
    paths = [str(where), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "COLUMNS": "200"}
    command = [sys.executable, "-m", "smolbot", *arguments]
    return subprocess.run(command, capture_output=True, text=True, env=environment, cwd=cwd, check=False)


def fly_briefly(where: Path, cwd: Path, *arguments: str) -> dict:
    """What a flight of a second leaves, which ends in time."""
    done = smolbot(where, cwd, "run", *arguments, *BRIEF, "--out", str(cwd / "run"))
    assert done.returncode == 1, done.stderr
    summary = json.loads(done.stdout)
    assert summary["status"] == "timeout", done.stderr
    assert summary["cycles"] >= 3
    return summary


def imports(path: Path) -> list[tuple[str, str]]:
    """Module and name of all that a file imports of ours."""
    found = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            found += [(node.module or "", alias.name) for alias in node.names]
        elif isinstance(node, ast.Import):
            found += [(alias.name, "") for alias in node.names]
    return [(module, name) for module, name in found if module.partition(".")[0] in OURS]


def documented() -> set[tuple[str, str]]:
    """Top package and last name of everything that the reference lists."""
    found, module = set(), ""
    for line in REFERENCE.read_text().splitlines():
        if current := re.match(r"\.\. currentmodule:: (\S+)", line):
            module = current[1]
        elif entry := re.match(r"(?:   |\.\. py:\w+:: )([\w.]+)$", line):
            full = entry[1] if entry[1].partition(".")[0] in OURS else f"{module}.{entry[1]}"
            found.add((full.partition(".")[0], full.rpartition(".")[2]))
    return found


FOREIGN = sorted(path for folder in (LAB, OWN_WORLD, HELICAL_LAW) for path in folder.rglob("*.py") if imports(path))


@pytest.mark.parametrize("path", FOREIGN, ids=[str(path.relative_to(HERE)) for path in FOREIGN])
def test_a_foreign_package_imports_documented_names_only(path):
    known = documented()
    for module, name in imports(path):
        assert module.count(".") <= 1, f"{module} is a module of ours, not a package"
        assert name in import_module(module).__all__, f"{module} has no public name {name}"
        assert (module.partition(".")[0], name) in known, f"{module}.{name} is not in {REFERENCE.name}"


def test_the_lab_has_a_part_of_every_kind():
    groups = {group.removeprefix("smolbot.") for group in PROJECT["project"]["entry-points"]}
    assert groups == {"rigs", "controllers", "estimators", "commands", "path_readers", "sensors", "studies"}


@pytest.mark.parametrize("section", ["", '\n[ours]\naddress = "10.0.0.7"\n'], ids=["without section", "with section"])
def test_a_labs_own_world_flies_with_and_without_a_section_of_its_own(tmp_path, section):
    text = list_shipped("rigs")["tank"].read_text().replace('world = "tank"', 'world = "ours"')
    (tmp_path / "our_rig.toml").write_text(text + section)
    fly_briefly(OWN_WORLD, tmp_path, "line", "--rig", "our_rig.toml")


def test_a_labs_own_helical_law_is_previewed_and_flies(tmp_path):
    law = ("s_path", "--set", "controller.law=mine")
    previewed = smolbot(HELICAL_LAW, tmp_path, "preview", *law, "--json")
    assert previewed.returncode == 0, previewed.stderr
    assert json.loads(previewed.stdout)["go"]
    summary = fly_briefly(HELICAL_LAW, tmp_path, *law, "--set", "stop.max_duration_s=40")
    assert summary["stop_reason"].startswith("max_duration_s")


def test_list_shows_every_part_of_the_lab(installed, tmp_path):
    listed = json.loads(smolbot(installed, tmp_path, "list", "--json").stdout)
    parts = {"controllers": "drift", "worlds": "bath", "path_readers": "polar", "sensor_kinds": "triaxial"}
    parts |= {"studies": "nearness", "estimators": "steady"}
    for group, name in parts.items():
        assert name in listed[group]


@pytest.mark.parametrize(
    "arguments",
    [
        ("line", "--rig", "bath.toml"),
        ("line", "--set", "controller.law=drift", "--set", "controller.gains.current_a=3"),
        ("line", "--set", "localization.estimator=steady"),
        ("spiral.toml",),
        ("line", "--rig", "cubes.toml"),
    ],
    ids=["world", "law", "estimator", "path reader", "kind of sensors"],
)
def test_each_part_of_the_lab_flies(installed, files, arguments):
    summary = fly_briefly(installed, files, *arguments)
    assert summary["localization_error_mm"]["mean"] < 1.0


def test_the_labs_command_is_a_command_of_smolbot(installed, files):
    done = smolbot(installed, files, "places", "cubes.toml")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[3] == "3: -75.0 62.0 0.0"
    assert len(done.stdout.splitlines()) == 30


def test_the_labs_study_runs_and_leaves_what_ours_leave(installed, tmp_path):
    out = tmp_path / "study"
    done = smolbot(installed, tmp_path, "study", "nearness", "--poses", "10", "--jobs", "2", "--out", "study", "--json")
    assert done.returncode == 0, done.stderr
    assert 40.0 < json.loads(done.stdout)["median_mm"] < 80.0
    assert {"study.json", "results.csv", "nearness.png"} <= {path.name for path in out.iterdir()}
    assert len((out / "results.csv").read_text().splitlines()) == 41


def test_a_triaxial_magnetometer_is_three_sensors_at_one_place(lab, files):
    rig = load_rig(str(files / "cubes.toml"))
    assert rig.sensors.positions.shape == (30, 3)
    assert (rig.sensors.axes[3:6] == [[1, 0, 0], [0, 1, 0], [0, 0, 1]]).all()
    assert 'kind = "triaxial"' in rig.document.text
    assert "positions_mm" not in rig.document.text


@pytest.mark.parametrize(
    ("file", "old", "new", "said"),
    [
        (
            "bath.toml",
            'address = "10.0.0.7"',
            "",
            r":\d: bath\.address: this key is missing; the section needs address",
        ),
        ("bath.toml", "address", "adress", r":6: bath\.adress: unknown key; known keys: address, temperature_c\. Did"),
        (
            "bath.toml",
            "[bath]",
            "[bath]\ntemperature_c = 120.0",
            r":6: bath\.temperature_c: must stay below 100; got 120",
        ),
        ("bath.toml", 'world = "bath"', "", r":5: bath: \[bath\] is of world 'bath', and this rig is of world 'tank'"),
        ("cubes.toml", "places_mm", "positions_mm", r":6: sensors\.positions_mm: unknown key; known keys: places_mm"),
        (
            "cubes.toml",
            "triaxial",
            "triaxal",
            r":5: sensors\.kind: no kind of sensor is named 'triaxal'.*Did you mean tri",
        ),
        ("cubes.toml", ALL_PLACES, "[[0, 0, 0]]", r":4: sensors: needs at least two places_mm; got 1"),
        ("cubes.toml", "kind", "full_scale_ut = -1.0\nkind", r":\d: sensors\.range_ut: input should be greater than 0"),
    ],
)
def test_a_fault_of_a_labs_own_keys_has_file_line_and_key(lab, files, file, old, new, said):
    (files / file).write_text((files / file).read_text().replace(old, new))
    with pytest.raises(ConfigError) as caught:
        load_rig(str(files / file))
    assert re.search(f"{file}{said}", str(caught.value)), caught.value


def test_a_path_that_the_labs_reader_cannot_read_is_a_fault_of_the_mission(lab, files):
    (files / "spiral.polar").write_text("2 0\nfour 20\n")
    with pytest.raises(ConfigError, match=r"spiral\.toml:5: path\.file: .*spiral\.polar: each line must be a radius"):
        load_mission(str(files / "spiral.toml"))


def test_a_path_file_without_a_reader_tells_which_there_are(files):
    with pytest.raises(
        ConfigError, match=r"spiral\.toml:5: path\.file: no reader of '\.polar' is installed; .*csv, svg"
    ):
        load_mission(str(files / "spiral.toml"))


def test_a_bench_may_hold_the_section_of_the_tank_that_stands_for_it():
    data = open_file("bench", "rigs").data
    assert data["world"] == "bench"
    assert {"bench", "tank"} <= set(data)
    with pytest.raises(ConfigError, match=r"bench: \[bench\] is of world 'bench', and this rig is of world 'tank'"):
        load_rig("bench", {"world": "tank"})


class Illiterate:
    has_shapes = False


class Shapeless:
    @staticmethod
    def read(path, element, width_mm, height_mm): ...


class Unexpanding:
    section = object


class Unfinished:
    name, title, notes = "unfinished", "Without an end", {}
    estimators, mission, rig_of, files = (), False, None, None

    @staticmethod
    def devices(): ...

    @staticmethod
    def chunks(options): ...

    @staticmethod
    def draw(outcome, path): ...


@pytest.mark.parametrize(
    ("group", "made", "said"),
    [
        (
            "path_readers",
            Illiterate,
            r"Path reader 'bad' .*: it has no method read\(path, element, width_mm, ",
        ),
        ("path_readers", Shapeless, r"it has no attribute 'has_shapes', ClassVar\[bool\]"),
        ("sensors", Unexpanding, r"Kind of sensors 'bad' .*: it has no method expand\(section\)"),
        ("studies", Unfinished, r"Study 'bad' .*: it has no method conclude\(options, parts\)"),
    ],
)
def test_a_part_that_breaks_its_promise_is_refused_when_loaded(plug_in, group, made, said):
    plug_in(group, "bad", made)
    with pytest.raises(PluginError, match=said):
        plugins.load_plugin(group, "bad")


def test_a_mission_whose_path_reader_breaks_its_promise_is_refused(plug_in, files):
    plug_in("path_readers", "polar", Illiterate)
    with pytest.raises(PluginError, match=r"Path reader 'polar' .* it has no method read"):
        load_mission(str(files / "spiral.toml"))
