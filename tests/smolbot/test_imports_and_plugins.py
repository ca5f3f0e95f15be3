"""What is loaded when, and what a foreign package of one of our names does."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import ClassVar

import pytest

import smolbot
from smolbot.config import plugins
from smolbot.errors import PluginError
from smolbot.motion.controller import Command, Gain

HEAVY = ("pybullet", "nidaqmx", "serial", "control", "matplotlib", "scipy.signal", "optuna", "viser", "magpylib")
HELP = "import sys; sys.argv = ['smolbot', *sys.argv[1:]]; from smolbot.ui.cli.app import main; main()"
AS_INSTALLED = (
    "import sys; sys.meta_path[:] = [f for f in sys.meta_path if 'editable' not in getattr(f, '__module__', '')]; "
)
"""Without the finder of an editable install, which would fill the gaps of a foreign package with our modules."""

HOME = str(Path(smolbot.__file__).parent.parent)


def python(code: str, *arguments: str, cwd: Path, path: list[Path] | None = None) -> subprocess.CompletedProcess[str]:
    """Run `code` as an installed command does: the current directory is not on the path."""
    search = os.pathsep.join(str(p) for p in [*(path or []), HOME])
    environment = {**os.environ, "PYTHONPATH": search}
    return subprocess.run(
        [sys.executable, "-P", "-c", AS_INSTALLED + code, *arguments],
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize(
    "code",
    [
        "import smolbot; dir(smolbot); import sim, controllers, lookup_tables",
        "import smolbot; [getattr(smolbot, name) for name in smolbot.__all__]",
        HELP.replace("main()", "\ntry: main()\nexcept SystemExit: pass"),
    ],
)
def test_heavy_packages_are_loaded_by_those_who_need_them_only(tmp_path, code):
    watch = f"\nimport sys; print([m for m in {HEAVY!r} if m in sys.modules])"
    done = python(code + watch, "--help", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip().splitlines()[-1] == "[]"


def test_every_public_name_can_be_had_from_the_top(tmp_path):
    for name in smolbot.__all__:
        assert getattr(smolbot, name) is not None
    assert set(smolbot.__all__) <= set(dir(smolbot))
    promised = "Pose Recording SensorArray Device NoiseModel Localizer Setup Controller Gain Command Rig Tracker run"
    assert set(promised.split()) <= set(smolbot.__all__)
    with pytest.raises(AttributeError, match="attribute Robots"):
        _ = smolbot.Robots


def test_help_names_every_command_and_loads_none(tmp_path):
    done = python(HELP, "--help", cwd=tmp_path)
    assert done.returncode == 0
    for command in ("run", "preview", "list", "init", "simulate", "table"):
        assert command in done.stdout


@pytest.fixture
def foreign(tmp_path):
    """A directory that holds foreign packages of the given names, found before ours."""

    def make(*names: str, text: str = "") -> Path:
        for name in names:
            (tmp_path / "foreign" / name).mkdir(parents=True)
            (tmp_path / "foreign" / name / "__init__.py").write_text(text)
        return tmp_path / "foreign"

    return make


@pytest.mark.parametrize("text", ["", "raise ImportError('a foreign package')\n"])
def test_a_foreign_package_named_sim_is_one_clear_error_and_the_rest_works(foreign, tmp_path, text):
    where = foreign("sim", text=text)
    for arguments in (["run", "line"], ["simulate", "line", "--seeds", "1"]):
        done = python(HELP, *arguments, cwd=tmp_path, path=[where])
        assert done.returncode == 2, done.stderr
        assert "Traceback" not in done.stderr
        assert len(done.stderr.strip().splitlines()) == 1
        assert str(where / "sim") in done.stderr
        assert "shadows ours" in done.stderr
    done = python(HELP, "list", cwd=tmp_path, path=[where])
    assert done.returncode == 0
    assert "r_small" in done.stdout


@pytest.mark.parametrize("text", ["", "raise ImportError('a foreign package')\n"])
def test_a_foreign_package_named_controllers_is_one_clear_error_and_the_rest_works(foreign, tmp_path, text):
    where = foreign("controllers", text=text)
    done = python(HELP, "preview", "line", cwd=tmp_path, path=[where])
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert str(where / "controllers") in done.stderr
    assert "shadows ours" in done.stderr
    assert python(HELP, "--help", cwd=tmp_path, path=[where]).returncode == 0


def test_foreign_packages_beside_the_mission_are_not_found_by_the_installed_command(foreign, tmp_path):
    where = foreign("controllers", "sim", text="raise ImportError('a foreign package')\n")
    done = python(HELP, "preview", "line", cwd=where)
    assert done.returncode == 0, done.stderr


class Lazy:
    """A controller of a lab: does nothing, and has one gain."""

    gains: ClassVar = {"patience": Gain(1.0, 0.0, 2.0)}

    def __init__(self, setup, gains):
        self.patience = gains.get("patience", 1.0)

    def reset(self, path, pose):
        pass

    def command(self, pose):
        return Command(None, note="resting")


@pytest.fixture
def lab(monkeypatch):
    """A lab's own controller, installed as an entry point."""
    real = plugins.entry_points
    own = EntryPoint("lazy", f"{__name__}:Lazy", "smolbot.controllers")
    broken = EntryPoint("broken", "no_such_package:Law", "smolbot.controllers")
    monkeypatch.setitem(sys.modules, __name__, sys.modules.get(__name__) or type(sys)("m"))
    sys.modules[__name__].Lazy = Lazy

    def found(group):
        return [*real(group=group), *([own, broken] if group == "smolbot.controllers" else [])]

    monkeypatch.setattr(plugins, "entry_points", found)
    plugins._find_entry_points.cache_clear()
    yield
    plugins._find_entry_points.cache_clear()


def test_a_labs_own_controller_is_found_by_its_entry_point(lab):
    assert plugins.load_plugin("controllers", "lazy") is Lazy
    assert plugins.list_plugins("controllers") == [
        "broken",
        "current_ratio",
        "force_pursuit",
        "helical",
        "lazy",
        "predictive",
    ]
    from smolbot.config.mission import load_steering_mission

    mission = load_steering_mission("line", settings={"controller.law": "lazy", "controller.gains.patience": "0.5"})
    assert mission.law == "lazy"
    with pytest.raises(ValueError, match="0 to 2"):
        load_steering_mission("line", settings={"controller.law": "lazy", "controller.gains.patience": "3.0"})


def test_a_mission_under_a_labs_own_controller_flies(lab):
    run = smolbot.run(
        "line", seed=1, controller__law="lazy", stop__max_duration_s=1.0, localization__quiet_s=0.0, force="preview"
    )
    assert run.status == "timeout"
    assert run.cycles[-1].command.note == "resting"


def test_a_controller_that_is_not_installed_or_broken_is_one_clear_error(lab):
    with pytest.raises(PluginError, match=r"No controller is named 'lasy'.*Did you mean lazy"):
        plugins.load_plugin("controllers", "lasy")
    with pytest.raises(PluginError, match=r"'broken' \(no_such_package:Law\) cannot be loaded"):
        plugins.load_plugin("controllers", "broken")
