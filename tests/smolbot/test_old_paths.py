"""Every path that was ever documented works, and warns once of what it is now."""

from __future__ import annotations

import pickle
import subprocess
import sys
import warnings
from importlib import import_module

import pytest

from smolbot.core.deprecated import MOVED, _find


def find_own_name(module):
    """A public name that a module or package defines itself."""
    objects = vars(import_module(module)).items()
    return next(
        name for name, found in objects if name[0] != "_" and getattr(found, "__module__", "").startswith(module)
    )


PATHS = sorted(path if ":" in path else f"{path}:{find_own_name(new)}" for path, new in MOVED.items())


def imported(path):
    """What a user's own code has from a path, and the warnings that it causes."""
    module, name = path.split(":")
    scope = {"__name__": "notebook"}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        exec(f"from {module} import {name}", scope)
    return scope[name], [warning for warning in caught if warning.category is DeprecationWarning]


@pytest.mark.parametrize("path", PATHS)
def test_an_old_path_gives_what_the_new_one_does_with_one_warning_that_names_it(path):
    new = MOVED.get(path) or f"{MOVED[path.split(':')[0]]}:{path.split(':')[1]}"
    found, caught = imported(path)
    assert found is _find(new)
    assert len(caught) == 1
    assert new.replace(":", ".") in str(caught[0].message)


@pytest.mark.parametrize("path", sorted(set(MOVED.values())))
def test_a_new_path_of_a_public_name_is_one_package_deep_and_gives_no_warning(path):
    module, _, name = path.partition(":")
    assert not name or name.startswith("_") or module.count(".") <= 1
    path = path if name else f"{module}:{find_own_name(module)}"
    assert imported(path)[1] == []


def test_other_names_of_a_watched_module_and_pickles_cause_no_warning():
    from smolbot.runs import Event

    assert imported("smolbot.runs.run:get_trusted_poses")[1] == []
    kept = pickle.dumps(Event(1.0, "paused"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert pickle.loads(kept) == Event(1.0, "paused")


def test_programs_of_ours_are_silent_however_they_are_started():
    command = [sys.executable, "-W", "error::DeprecationWarning:__main__", "-m", "sim.measure.kills", "--help"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_name_that_never_was_is_an_error_as_elsewhere():
    for module in ("smolbot.control", "smolbot.runs.run", "smolbot.hardware.stage"):
        with pytest.raises(ImportError):
            imported(f"{module}:NeverThere")
    with pytest.raises(ModuleNotFoundError):
        imported("smolbot.never:There")
