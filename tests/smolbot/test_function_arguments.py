"""What a program passes to the public functions is checked before anything flies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import smolbot
from smolbot.errors import InputError


@pytest.mark.parametrize("seed", [-1, 1.5, "a", None, float("nan")])
def test_a_seed_is_a_whole_number(seed):
    for use in (
        lambda: smolbot.run("line", seed=seed),
        lambda: smolbot.simulate("line", [seed], plant="reduced"),
        lambda: smolbot.tune("line", seed=seed),
    ):
        with pytest.raises(InputError, match=r"seeds? must be a whole number of at least 0; got "):
            use()


@pytest.mark.parametrize("seeds", [3, None])
def test_seeds_are_several(seeds):
    with pytest.raises(InputError, match=r"seeds must be whole numbers, such as range\(1, 21\); got "):
        smolbot.simulate("line", seeds)


@pytest.mark.parametrize("jobs", [-1, 1.5, "a", None])
def test_jobs_are_a_whole_number(jobs):
    for use in (lambda: smolbot.simulate("line", [1], jobs=jobs), lambda: smolbot.tune("line", jobs=jobs)):
        with pytest.raises(InputError, match="jobs must be a whole number of at least 0; got "):
            use()


@pytest.mark.parametrize("name", ["trials", "worlds", "held_out"])
@pytest.mark.parametrize("value", [0, -1, 1.5, "a"])
def test_a_search_needs_one_of_each_at_least(name, value):
    with pytest.raises(InputError, match=f"{name} must be a whole number of at least 1; got "):
        smolbot.tune("line", **{name: value})


def test_an_unknown_plant_is_told_with_those_that_exist():
    for use in (lambda: smolbot.simulate("line", [1], plant="ful"), lambda: smolbot.tune("line", plant="ful")):
        with pytest.raises(InputError, match=r"plant must be one of full, reduced; got 'ful'\. Did you mean full\?"):
            use()


@pytest.mark.parametrize("mission", [3, None, Path("line")])
@pytest.mark.parametrize(
    "use",
    [smolbot.run, smolbot.preview, smolbot.load_mission, smolbot.tune, lambda mission: smolbot.simulate(mission, [1])],
    ids=["run", "preview", "load_mission", "tune", "simulate"],
)
def test_a_mission_that_is_no_text_is_refused(use, mission):
    with pytest.raises(InputError, match="name or (a )?path.*; got "):
        use(mission)


def test_numbers_of_numpy_are_settings():
    offset = np.array([0.0, 1.0])
    seen = smolbot.preview("line", stop__lost_shots=np.int64(5), start__offset_mm=offset)
    assert seen.go


def test_what_no_file_holds_is_no_setting():
    with pytest.raises(InputError, match=r"A setting must be text, a number, or a list or table of them; got <object"):
        smolbot.run("line", controller__tolerance_mm=object())


@pytest.mark.parametrize("run", [3, None, ["runs/monday"]])
def test_a_run_that_is_no_path_is_refused(run):
    for use in (smolbot.read_run, smolbot.replay):
        with pytest.raises(InputError, match="A run is named by a path, of its folder or its record; got "):
            use(run)


@pytest.mark.parametrize("force", [3, True, ["preview"], "previw"])
def test_only_a_preview_can_be_overruled(force):
    for use in (smolbot.run, lambda mission, force: smolbot.simulate(mission, [1], force=force), smolbot.tune):
        with pytest.raises(InputError, match="force must be one of preview; got "):
            use("line", force=force)
