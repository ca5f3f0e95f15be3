"""The promise of a rig, kept by the simulated tank; and that what it draws, it draws from the seed."""

from __future__ import annotations

import json
import threading

import numpy as np
import pytest

from sim.tank.mismatch import RandomStreams, sample_truth
from sim.tank.settings import MismatchSection, TankSettings
from sim.tank.world import TankWorld
from smolbot.config.document import Document
from smolbot.core.rig import Rig, Witness
from smolbot.core.shots import Actuate, Excite, Listen, RingDown, Rotate, Shot
from smolbot.errors import InputError, InterlockError, RigError

CYCLE = Shot((Actuate((8.0, 0.0, 3.0, 0.0), 0.03), Excite((6.0, 6.0), 103.5, 5), RingDown(0.02), Listen(2, 103.5)))
QUIET = Shot((Listen(20, 103.5),), mode="quiet")
PULL = Shot((Actuate((8.0, 0.0, 0.0, 0.0), 0.1),))


def test_tank_keeps_the_shape_of_the_promise(open_tank):
    rig = open_tank()
    assert isinstance(rig, Rig)
    assert isinstance(rig.witness, Witness)
    json.dumps(rig.provenance())


def test_same_seed_gives_bit_identical_recordings_and_truth(open_tank):
    first, second = open_tank(seed=7), open_tank(seed=7)
    for shot in (CYCLE, QUIET, CYCLE):
        assert np.array_equal(first.play(shot).field, second.play(shot).field)
    pose, twin = first.witness.truth(0.3), second.witness.truth(0.3)
    assert np.array_equal(pose.position, twin.position)
    assert np.array_equal(pose.orientation, twin.orientation)


def test_other_seeds_give_other_tanks(open_tank):
    first, second = open_tank(seed=7), open_tank(seed=8)
    assert not np.array_equal(first.play(CYCLE).field, second.play(CYCLE).field)
    assert first.provenance()["truth"] != second.provenance()["truth"]


def test_without_the_witness_nothing_else_changes(open_tank):
    watched, alone = open_tank(seed=3), open_tank(seed=3)
    alone.witness = None
    for _ in range(3):
        watched.witness.truth(watched.now())
        assert np.array_equal(watched.play(CYCLE).field, alone.play(CYCLE).field)


def test_a_recording_has_its_time_and_its_drive(open_tank):
    rig = open_tank()
    heard = rig.play(CYCLE)
    assert heard.field.shape == (10, round(CYCLE.listen.duration * 50_000))
    assert heard.clock == pytest.approx(0.03 + 5 / 103.5 + 0.02)
    assert heard.time_since_drive == pytest.approx(0.02)
    assert heard.drive == CYCLE.excite
    assert rig.now() == pytest.approx(CYCLE.duration + 2e-3)
    quiet = rig.play(QUIET)
    assert quiet.drive is None
    assert quiet.time_since_drive > 1e3
    assert rig.play(PULL) is None


@pytest.mark.parametrize(
    "bad",
    [
        Shot((Actuate((9.0, 0, 0, 0), 0.03),)),
        Shot((Actuate((-1.0, 0, 0, 0), 0.03),)),
        Shot((Excite((11.0, 0.0), 103.5, 5),)),
        Shot((Rotate((0, 0, 1), 0.25, 1.0),)),
        Shot((Excite((1.0, 0.0), 103.5, 5), Listen(2, 103.5))),
    ],
)
def test_a_shot_beyond_a_limit_is_refused_before_anything_moves(open_tank, bad):
    rig = open_tank()
    rig.play(CYCLE)
    before, truth = rig.now(), rig.witness.truth(rig.now())
    with pytest.raises(InterlockError, match="Nothing was played"):
        rig.play(bad)
    assert rig.now() == before
    assert np.array_equal(rig.witness.truth(before).position, truth.position)


def test_witness_knows_only_what_was_played(open_tank):
    rig = open_tank()
    assert rig.witness.truth(0.0).time == 0.0
    with pytest.raises(InputError, match="true pose is recorded"):
        rig.witness.truth(0.001)
    rig.play(CYCLE)
    with pytest.raises(InputError, match="true pose is recorded"):
        rig.witness.truth(rig.now() + 0.01)
    with pytest.raises(InputError, match="true pose is recorded"):
        rig.witness.truth(-0.01)
    pose = rig.witness.truth(rig.now())
    assert not pose.covariance.any()


def test_truth_is_continuous_across_shots(open_tank):
    rig = open_tank()
    for _ in range(5):
        rig.play(CYCLE)
    times = np.linspace(0, rig.now(), 2000)
    places = np.array([rig.witness.truth(t).position for t in times])
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() < 20e-3 * times[1]


@pytest.mark.parametrize(("coil", "direction"), [(0, (1, 0)), (1, (-1, 0)), (2, (0, 1)), (3, (0, -1))])
def test_a_coil_pulls_the_robot_to_its_side(open_tank, coil, direction):
    rig = open_tank(seed=coil)
    currents = np.zeros(4)
    currents[coil] = 8.0
    start = None
    for _ in range(20):
        rig.play(Shot((Actuate(tuple(currents), 0.1),)))
        start = start if start is not None else rig.witness.truth(0.0).position
    moved = (rig.witness.truth(rig.now()).position - start)[:2]
    assert moved @ direction > 1e-3
    assert moved @ direction > 0.8 * np.linalg.norm(moved)


def test_robot_is_put_down_near_the_start_level_and_afloat(open_tank):
    offsets, headings = [], []
    for seed in range(8):
        rig = open_tank(seed=seed, start=(0.005, -0.004))
        rig.play(QUIET)
        pose = rig.witness.truth(0.0)
        offsets.append(pose.position[:2] - [0.005, -0.004])
        headings.append(np.arctan2(*pose.body_axis("z")[1::-1]))
        assert pose.body_axis("y")[2] == pytest.approx(1.0, abs=1e-6)
        assert 0.058 < pose.position[2] < 0.061
    assert np.abs(offsets).max() < 1.5e-3
    assert np.ptp(headings) > 1.0


def test_a_start_outside_the_container_is_refused(open_tank):
    with pytest.raises(InputError, match="container"):
        open_tank(start=(0.03, 0.0))


def test_doubling_the_mismatch_doubles_every_sample_and_ideal_samples_nothing():
    def truth(scale, ideal=False):
        settings = TankSettings(mismatch=MismatchSection(scale=scale))
        return sample_truth(settings, 6, 10, RandomStreams.from_seed(4), ideal=ideal)

    once, twice, none = truth(1.0), truth(2.0), truth(2.0, ideal=True)
    assert np.allclose(twice.coil_places, 2 * once.coil_places)
    assert np.allclose(twice.sensor_tilts, 2 * once.sensor_tilts)
    assert twice.moment - 1 == pytest.approx(2 * (once.moment - 1))
    for name, value in none.as_dict().items():
        if not name.startswith(("start", "flow")):  # sampled at every scale: no model says what they are
            nominal = 0.0 if name.endswith(("places", "tilts", "tilt")) else 1.0
            assert np.all(np.asarray(value) == nominal), name


def test_doubling_the_mismatch_changes_the_recording(open_tank):
    once, twice = open_tank(seed=2), open_tank(seed=2, tank__mismatch__scale="2.0")
    assert not np.array_equal(once.play(CYCLE).field, twice.play(CYCLE).field)


def test_stop_ends_a_shot_under_way_and_the_rig_plays_on(open_tank):
    rig = open_tank()
    long = Shot((Listen(600, 103.5),))
    timer = threading.Timer(0.02, rig.stop)

    def play_until_stopped():
        for _ in range(100):
            rig.play(long)

    timer.start()
    with pytest.raises(RigError, match="every output is at zero"):
        play_until_stopped()
    timer.join()
    rig.stop()
    rig.stop()
    assert rig.play(CYCLE).field.shape[0] == 10
    times = np.linspace(0, rig.now(), 200)
    assert all(np.isfinite(rig.witness.truth(t).position).all() for t in times)


def test_a_closed_tank_plays_nothing(open_tank):
    rig = open_tank()
    rig.close()
    rig.close()
    with pytest.raises(RigError, match="closed"):
        rig.play(CYCLE)


def test_windows_that_are_no_multiple_of_the_step_are_filled_exactly(open_tank):
    rig = open_tank(turnaround_ms="0.0")
    odd = Shot((Actuate((1.0, 0, 0, 0), 0.0123456), RingDown(0.0071), Listen(1, 103.5)))
    rig.play(odd)
    assert rig.now() == pytest.approx(odd.duration, abs=1e-12)
    assert rig.play(odd).clock == pytest.approx(odd.duration + 0.0194456, abs=1e-9)


def test_faults_of_the_tank_section_are_reported_by_line_and_key(tmp_path):
    path = tmp_path / "my.toml"
    path.write_text('name = "x"\n[tank]\nphysics_step_ms = 0\n[tank.mismatch]\ncoil_plase_mm = 0.3\n')
    document = Document.read(path)
    faults = TankWorld.check(document)
    message = str(document.error(faults))
    assert "my.toml:3: tank.physics_step_ms" in message
    assert "my.toml:5: tank.mismatch.coil_plase_mm: unknown key" in message
    assert "Did you mean coil_place_mm?" in message


def test_a_window_needs_a_display(rig, robot, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(InputError, match="DISPLAY"):
        TankWorld.open(rig, robot, (0, 0), 1, gui=True)
