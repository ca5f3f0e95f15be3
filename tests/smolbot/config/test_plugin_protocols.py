"""A plug-in that keeps its protocol is used, whatever else it lacks; one that breaks it is refused when loaded."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

import smolbot
from controllers.force_pursuit import ForcePursuit
from controllers.helical import Helical
from sim.tank.world import TankWorld
from smolbot import Command, Gain, load_mission
from smolbot.config import plugins
from smolbot.core.rig import Witness
from smolbot.errors import PluginError
from smolbot.flight.preview.gradient import preview
from smolbot.flight.preview.helix import preview_helix
from smolbot.flight.stall import STALL_TIME
from smolbot.motion.controller import Controller, robot_kinds

SHORT = {"path.points_mm": "[[-1.0, 0.0], [1.5, 0.0]]", "localization.quiet_s": "2.0"}


class Bare:
    """A law with what the protocol asks for, and nothing else."""

    gains: ClassVar = {"patience": Gain(1.0, 0.0, 2.0)}

    def __init__(self, setup, gains):
        pass

    def reset(self, path, pose):
        pass

    def command(self, pose):
        return Command(None, note="resting")


class Wrapping(Bare):
    """A law that hands on to one of ours what the protocol asks for, and nothing else."""

    ours: ClassVar = ForcePursuit
    gains: ClassVar = ForcePursuit.gains

    def __init__(self, setup, gains):
        self._law = self.ours(setup, gains)

    def reset(self, path, pose):
        self._law.reset(path, pose)

    def command(self, pose):
        return self._law.command(pose)


class Screw(Wrapping):
    kinds = ("helical",)
    ours = Helical
    gains = Helical.gains


def test_what_a_law_may_leave_out_is_looked_for_by_nobody(plug_in):
    plug_in("controllers", "ours", Wrapping)
    mission = load_mission("line", settings={**SHORT, "controller.law": "ours"})
    shown = preview(mission)
    assert shown.go
    assert shown.force_profile is None
    assert robot_kinds(Wrapping) == ("gradient",)
    assert smolbot.run(mission, seed=3, force="preview").status == "completed"


class Untold(Wrapping):
    """Says neither where on the path it is nor whether it is on it."""

    def command(self, pose):
        return replace(self._law.command(pose), progress=0.0, phase="follow")


def test_a_slow_law_that_tells_no_progress_is_not_taken_for_one_that_stalls(plug_in):
    plug_in("controllers", "untold", Untold)
    settings = {"controller.law": "untold", "controller.gains.force_un": "12", "stop.max_duration_s": "600"}
    shown = preview(load_mission("line", settings=settings))
    assert shown.duration > STALL_TIME
    assert shown.go, shown.reasons


def test_a_helical_law_that_does_not_tell_its_bend_is_previewed_all_the_same(plug_in):
    plug_in("controllers", "screw", Screw)
    mission, theirs = (load_mission("s_path", settings={"controller.law": law}) for law in ("screw", "helical"))
    shown, other = preview_helix(mission), preview_helix(theirs)
    assert shown.go
    assert shown.min_radius is None
    assert np.array_equal(shown.trail, other.trail)
    run = smolbot.run(mission, seed=1, witness=False)
    assert run.status == "completed", run.stop_reason


LAW = """
from controllers.{module} import {law}
class Law:
    kinds = {kinds}
    gains = {law}.gains
    def __init__(self, setup, gains): self._law = {law}(setup, gains)
    def reset(self, path, pose): self._law.reset(path, pose)
    def command(self, pose): return self._law.command(pose)
"""


@pytest.mark.parametrize(
    ("mission", "law", "kind", "says"),
    [
        ("line", "ForcePursuit", "gradient", "the law 'lab' has no method reach(path)"),
        ("s_path", "Helical", "helical", "the law 'lab' has no method tightest_bend()"),
    ],
)
def test_preview_says_what_it_cannot_show_of_an_installed_law(tmp_path, mission, law, kind, says):
    _install(tmp_path, law, kind)
    asked = ["preview", mission, "--set", "controller.law=lab"]
    shown = _smolbot(tmp_path, *asked)
    assert shown.returncode == 0, shown.stderr
    assert says in " ".join(shown.stdout.split())
    told = json.loads(_smolbot(tmp_path, *asked, "--json").stdout)
    assert told["go"]
    unknown = told["force_un"] if kind == "gradient" else told["bend_radius_mm"]["robot"]
    assert unknown is None


@pytest.mark.parametrize(
    ("mission", "law", "kind", "gain", "plant"),
    [("line", "ForcePursuit", "gradient", "force_un", "reduced"), ("s_path", "Helical", "helical", "listens", "full")],
)
def test_an_installed_law_is_tuned(tmp_path, mission, law, kind, gain, plant):
    """Short flights, of which none arrives: what counts is that they are flown and come to a verdict."""
    _install(tmp_path, law, kind)
    brief = ["--set", "controller.law=lab", "--set", "stop.max_duration_s=40", "--set", "localization.quiet_s=2"]
    few = ["--trials", "2", "--worlds", "1", "--held-out", "1", "--jobs", "1", "--only", gain, "--plant", plant,
           "--force", "preview"]  # fmt: skip
    done = _smolbot(tmp_path, "tune", mission, *brief, *few, "--out", str(tmp_path / "tuned"), "--json")
    assert done.returncode in (0, 1), done.stderr
    found = json.loads(done.stdout)
    assert found["law"] == "lab"
    assert found["verdict"] in ("better", "not better")


def _install(path: Path, law: str, kind: str) -> None:
    """A distribution ``lab`` with one law that hands on to one of ours what the protocol asks for."""
    module = {"ForcePursuit": "force_pursuit", "Helical": "helical"}[law]
    (path / "lab.py").write_text(LAW.format(module=module, law=law, kinds=(kind,)))
    (path / "lab-0.1.dist-info").mkdir()
    (path / "lab-0.1.dist-info/METADATA").write_text("Metadata-Version: 2.1\nName: lab\nVersion: 0.1\n")
    (path / "lab-0.1.dist-info/entry_points.txt").write_text("[smolbot.controllers]\nlab = lab:Law\n")


def _smolbot(path: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    import os

    paths = [str(path), *filter(None, [os.environ.get("PYTHONPATH")])]
    where = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "COLUMNS": "200"}
    command = [sys.executable, "-m", "smolbot", *arguments]
    return subprocess.run(command, capture_output=True, text=True, env=where, check=False)


class WithoutCommand:
    gains: ClassVar = {}

    def __init__(self, setup, gains): ...

    def reset(self, path, pose): ...


class Ungained:
    def __init__(self, setup, gains): ...

    def reset(self, path, pose): ...

    def command(self, pose): ...


class ShortReset(Bare):
    def reset(self, path): ...


class Turned(Bare):
    def reset(self, pose, path): ...


class Greedy(Bare):
    def command(self, pose, speed): ...


class Unmade(Bare):
    def __init__(self, setup): ...


class Plain(Bare):
    command = 3


class DeafWorld(TankWorld):
    @staticmethod
    def open(rig, robot, start, seed, *, gui=False): ...


class UnboundWorld(TankWorld):
    def unfit(self, rig, robot): ...


class HalfWorld:
    @staticmethod
    def check(document): ...


BROKEN = [
    ("rigs", UnboundWorld, "unfit() needs 'robot', which is not passed; it is called as unfit(rig, robot)"),
    ("controllers", WithoutCommand, "it has no method command(pose)"),
    ("controllers", Ungained, "it has no attribute 'gains', ClassVar[Mapping[str, Gain]]"),
    ("controllers", ShortReset, "reset() lacks the parameter 'pose'; it is called as reset(path, pose)"),
    ("controllers", Turned, "reset() takes them in another order, (pose, path); it is called as reset(path, pose)"),
    ("controllers", Greedy, "command() needs 'speed', which is not passed; it is called as command(pose)"),
    ("controllers", Unmade, "__init__() lacks the parameter 'gains'; it is called as __init__(setup, gains)"),
    ("controllers", Plain, "it has no method command(pose)"),
    (
        "rigs",
        DeafWorld,
        "open() lacks the parameter '**options'; it is called as open(rig, robot, start, seed, **options)",
    ),
    (
        "rigs",
        HalfWorld,
        "it has no method unfit(rig, robot); it has no method open(rig, robot, start, seed, **options)",
    ),
    ("commands", Bare.gains, "must be a function or a class"),
]


@pytest.mark.parametrize(("group", "plugin", "fault"), BROKEN, ids=[fault for _, _, fault in BROKEN])
def test_a_plug_in_that_breaks_its_protocol_is_refused_when_loaded(plug_in, group, plugin, fault):
    plug_in(group, "bad", plugin)
    with pytest.raises(PluginError) as refused:
        plugins.load_plugin(group, "bad")
    said = str(refused.value)
    assert said.startswith(f"{group[:-1].capitalize()} 'bad' (plugged_in_bad:made) ")
    assert fault in said


def test_a_mission_with_a_law_that_breaks_its_protocol_is_refused_before_anything_is_opened(plug_in):
    plug_in("controllers", "bad", ShortReset)
    with pytest.raises(PluginError, match="lacks the parameter 'pose'"):
        load_mission("line", settings={"controller.law": "bad"})


def test_other_names_defaults_and_more_than_is_asked_for_keep_a_protocol():
    class Law(Bare):
        def __init__(self, beliefs, tuned, *, verbose=False): ...

        def reset(self, *anything): ...

        @classmethod
        def command(cls, where, slowly=True): ...

    plugins.check_protocol(Law, Controller, "Law")
    plugins.check_protocol(Law(None, None), Controller, "Law")


def test_every_plug_in_of_ours_keeps_its_protocol():
    for group in plugins.PROTOCOLS:
        for name in plugins.list_plugins(group):
            plugins.load_plugin(group, name)


def test_whatever_a_foreign_module_does_when_imported_is_one_clear_error(plug_in):
    plug_in("controllers", "bad", None)
    with pytest.raises(PluginError, match=r"'bad' \(plugged_in_bad:made\) cannot be loaded: ZeroDivisionError: by me"):
        plugins.load_plugin("controllers", "bad")


def test_a_world_that_opens_what_is_no_rig_is_refused_before_anything_is_played(monkeypatch):
    played = []

    class Half:
        sensors = limits = None

        def play(self, shot, slowly):
            played.append(shot)

        def now(self): ...

        def stop(self): ...

        def close(self): ...

    class HalfWorld(TankWorld):
        @staticmethod
        def open(rig, robot, start, seed, **options):
            return Half()

    monkeypatch.setattr("smolbot.flight.session.load_world", lambda name, document: HalfWorld)
    mission = load_mission("line", settings=SHORT)
    with pytest.raises(PluginError) as refused:
        smolbot.run(mission, force="preview")
    said = str(refused.value)
    assert said.startswith("What world 'tank' opens breaks its protocol, smolbot.core.rig.Rig: it has no attribute")
    for fault in (
        "it has no attribute 'witness', Witness | None",
        "play() needs 'slowly', which is not passed; it is called as play(shot)",
        "it has no method excitation_field(position)",
    ):
        assert fault in said
    assert not played


def test_gains_that_are_none_are_refused(plug_in):
    class Numbers(Bare):
        gains: ClassVar = {"patience": 1.0}

    plug_in("controllers", "bad", Numbers)
    with pytest.raises(PluginError, match=r"Controller 'bad'.*gains\['patience'\] must be a Gain; got 1.0"):
        load_mission("line", settings={"controller.law": "bad"})


def test_an_object_keeps_a_protocol_as_a_class_does():
    class Known:
        def truth(self, time): ...

    plugins.check_protocol(Known(), Witness, "it")
    with pytest.raises(PluginError, match=r"it has no method truth\(time\)"):
        plugins.check_protocol(object(), Witness, "it")


def test_two_packages_with_one_name_are_refused_with_both(plug_in):
    plug_in("controllers", "helical", Screw)
    with pytest.raises(PluginError, match=r"Several packages have a controller 'helical': .*Helical, plugged_in_hel"):
        plugins.load_plugin("controllers", "helical")
