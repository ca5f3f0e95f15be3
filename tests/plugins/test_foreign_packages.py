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
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import ClassVar

import pytest

from controllers import ForcePursuit
from sim.studies import Options, cut_chunks
from sim.studies.command import run_study
from smolbot import Command, Listen, preview
from smolbot import run as smolbot_run
from smolbot.config import plugins
from smolbot.config.library import list_shipped, open_file
from smolbot.config.load import load_mission
from smolbot.config.rig import load_rig
from smolbot.errors import ConfigError, PluginError
from smolbot.localization import PoseEstimatorBase
from smolbot.ui.cli.app import BAD_INPUT, main

HERE = Path(__file__).parent
LAB, OWN_WORLD, HELICAL_LAW = HERE / "lab", HERE / "own_world", HERE / "helical_law"
OURS = ("smolbot", "controllers", "lookup_tables", "sim")
PROJECT = tomllib.loads((LAB / "pyproject.toml").read_text())
REFERENCE = HERE.parents[1] / "docs/reference/api.rst"

BRIEF = ("--set", "stop.max_duration_s=1", "--set", "localization.quiet_s=0", "--force", "preview", "--no-report",
         "--json")  # fmt: skip

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


class OwnLaw(ForcePursuit):
    """A lab's law; what it does wrong is set by each test."""

    fails_in: ClassVar[str] = ""
    change: ClassVar[Callable[[Command], object]] = staticmethod(lambda command: command)

    def reset(self, path, pose):
        if self.fails_in == "reset":
            raise KeyError("by a lab")
        super().reset(path, pose)

    def command(self, pose):
        if self.fails_in == "command":
            raise KeyError("by a lab")
        return self.change(super().command(pose))


class OwnEstimator(PoseEstimatorBase):
    """A lab's estimator that can only fail."""

    def locate(self, recording, prior=None):
        raise ValueError("by a lab")


BRIEFLY = {"localization__quiet_s": 0.0, "stop__max_duration_s": 1.0}
PLACE = r"KeyError: 'by a lab' \(.*test_foreign_packages\.py:\d+\)"


@pytest.mark.parametrize("call", ["reset", "command"])
@pytest.mark.parametrize("use", [smolbot_run, preview], ids=["run", "preview"])
def test_a_law_that_fails_is_named_with_the_line(plug_in, monkeypatch, use, call):
    monkeypatch.setattr(OwnLaw, "fails_in", call)
    plug_in("controllers", "own", OwnLaw)
    with pytest.raises(PluginError, match=rf"Controller \S*:OwnLaw failed in {call}\(\): {PLACE}") as caught:
        use("line", controller__law="own", **BRIEFLY)
    assert isinstance(caught.value.__cause__, KeyError)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda command: None, r"command\(\) must return a Command; got None"),
        (lambda command: replace(command, window=Listen(2, 103.5)), r"the window of a command must be an Actuate, .*"),
        (lambda command: replace(command, window="full"), r"the window of a command must be .*; got 'full'"),
        (
            lambda command: replace(command, progress="all"),
            r"the progress of a command must be a length in m; got 'all'",
        ),
        (lambda command: replace(command, progress=float("nan")), r"the progress of a command must be .*; got nan"),
    ],
)
def test_a_law_that_returns_what_no_loop_can_play_is_refused(plug_in, monkeypatch, tmp_path, change, said):
    monkeypatch.setattr(OwnLaw, "change", staticmethod(change))
    plug_in("controllers", "own", OwnLaw)
    with pytest.raises(PluginError, match=rf"Controller \S*:OwnLaw: {said}"):
        smolbot_run("line", out=tmp_path / "run", report=False, controller__law="own", force="preview", **BRIEFLY)
    summary = json.loads((tmp_path / "run/summary.json").read_text())
    assert summary["status"] == "failed"
    assert "OwnLaw" in summary["stop_reason"]


def test_an_estimator_that_fails_in_flight_is_named(plug_in):
    plug_in("estimators", "own", OwnEstimator)
    with pytest.raises(PluginError, match=r"Estimator \S*:OwnEstimator failed in locate\(\): ValueError: by a lab"):
        smolbot_run("line", localization__estimator="own", force="preview", **BRIEFLY)


def test_a_pose_that_is_no_pose_is_refused(plug_in, monkeypatch):
    monkeypatch.setattr(OwnEstimator, "locate", lambda self, recording, prior=None: (1.0, 2.0, 3.0))
    plug_in("estimators", "own", OwnEstimator)
    with pytest.raises(PluginError, match=r"OwnEstimator: locate\(\) must return a Pose; got \(1\.0, 2\.0, 3\.0\)"):
        smolbot_run("line", localization__estimator="own", force="preview", **BRIEFLY)


def test_gains_that_are_no_mapping_are_refused(plug_in, monkeypatch):
    monkeypatch.setattr(OwnLaw, "gains", ["ahead_mm"])
    plug_in("controllers", "own", OwnLaw)
    with pytest.raises(PluginError, match=r"Controller 'own' .*: gains must map names to Gains; got \['ahead_mm'\]"):
        load_mission("line", settings={"controller.law": "own"})


def test_a_path_reader_that_fails_is_named(plug_in, files):
    class Broken:
        has_shapes = False

        @staticmethod
        def read(path, element, width_mm, height_mm):
            raise KeyError("by a lab")

    plug_in("path_readers", "polar", Broken)
    with pytest.raises(PluginError, match=rf"Path reader \S*Broken failed in read\(\): {PLACE}"):
        load_mission(str(files / "spiral.toml"))


@pytest.mark.parametrize("expanded", [None, [1]])
def test_a_kind_of_sensors_that_expands_to_no_mapping_is_named(lab, files, monkeypatch, expanded):
    kind = plugins.load_plugin("sensors", "triaxial")
    monkeypatch.setattr(kind, "expand", staticmethod(lambda section: expanded))
    with pytest.raises(PluginError, match=r"Kind of sensors lab_parts\.triaxial:Triaxial failed in expand\(\)"):
        load_rig(str(files / "cubes.toml"))


@pytest.mark.parametrize("faults", [None, ["wrong"]])
def test_a_world_whose_check_returns_no_faults_is_named(lab, files, monkeypatch, faults):
    world = plugins.load_plugin("rigs", "bath")
    monkeypatch.setattr(world, "check", staticmethod(lambda document: faults))
    with pytest.raises(PluginError, match=r"World .*[Bb]ath.*check\(\)"):
        load_rig(str(files / "bath.toml"))


def test_a_study_whose_pieces_fail_is_named(lab, tmp_path):
    study = plugins.load_plugin("studies", "nearness")

    def fail(chunk):
        raise KeyError("by a lab")

    broken = replace(study, chunks=lambda options: cut_chunks(options, fail, [("piece", {})]))
    with pytest.raises(PluginError, match=rf"Study \S*fail failed in \S*fail\(\): {PLACE}"):
        run_study(broken, Options("nearness", 1, 1, None, "tank", None, ()), tmp_path / "study")


def test_a_study_that_returns_no_rows_or_no_outcome_is_refused(lab, tmp_path):
    study = plugins.load_plugin("studies", "nearness")
    options = Options("nearness", 1, 1, None, "tank", None, ())
    empty = replace(study, chunks=lambda options: cut_chunks(options, lambda chunk: None, [("piece", {})]))
    with pytest.raises(PluginError, match=r"Study \S*lambda> must return columns by their name; got None"):
        run_study(empty, options, tmp_path / "empty")
    endless = replace(study, conclude=lambda options, parts: None)
    with pytest.raises(PluginError, match=r"Study 'nearness': conclude\(\) must return an Outcome; got None"):
        run_study(endless, options, tmp_path / "endless")


def test_a_module_that_exits_when_imported_is_refused(plug_in, monkeypatch):
    plug_in("controllers", "own", OwnLaw)
    monkeypatch.setattr(plugins.EntryPoint, "load", lambda point: sys.exit(3))
    with pytest.raises(PluginError, match=r"'own' \(.*\) cannot be loaded: SystemExit: 3"):
        plugins.load_plugin("controllers", "own")


def test_a_command_that_fails_is_named_and_is_no_failed_verdict(plug_in, monkeypatch, capsys):
    def measure(times: int = 1) -> None:
        raise KeyError("by a lab")

    plug_in("commands", "measure", measure)
    monkeypatch.setattr(sys, "argv", ["smolbot", "measure", "--times", "2"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == BAD_INPUT
    assert re.fullmatch(rf"Command \S*measure failed in \S*measure\(\): {PLACE}\.\n", capsys.readouterr().err)
