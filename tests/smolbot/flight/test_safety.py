"""What ends a run, each with its reason; that it latches; and that nothing else is stopped or changed by it."""

from __future__ import annotations

import json
import math
import threading
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from smolbot.config.load import load_mission
from smolbot.config.plugins import load_world
from smolbot.config.rig import load_rig
from smolbot.core.coil_heat import CoilHeat, ThermalCoil, advance_temperature
from smolbot.core.limits import Limits
from smolbot.core.pose import Pose
from smolbot.core.sensing import Recording
from smolbot.core.shots import Actuate, Excite, Listen, MoveMagnet, RingDown, Rotate, Shot
from smolbot.errors import OperatorStopError, RigError, SafetyError
from smolbot.flight.assembly import make_loop, make_safety
from smolbot.flight.safety.duty_cycle import DutyCycle
from smolbot.flight.safety.sensor_monitor import SensorMonitor
from smolbot.flight.safety.stop_latch import Latch
from smolbot.flight.safety.supervisor import Safety, SafetyRules, make_limits_only_safety
from smolbot.flight.session import fly
from smolbot.runs.folder import RunFolder

LIMITS = Limits(("+x", "-x"), max_current=8.0, max_rotation_frequency=1.0)
LISTEN = Listen(2, 100.0)
SHORT = {"path.points_mm": "[[-1.0, 0.0], [1.5, 0.0]]", "start.offset_mm": "[-0.5, 0.3]", "localization.quiet_s": "4.0"}


def a_safety(*, rules=None, duty=None, heat=None, sensors=3, patience=2, broken=()):
    names = ("+x", "-x", "excitation x", "excitation y")
    return Safety(
        LIMITS, rules or SafetyRules(), duty or DutyCycle(names, 10.0), heat or CoilHeat((None,) * 4, 25.0),
        SensorMonitor(sensors, patience, broken),
    )  # fmt: skip


def pulling(start=0.0, current=8.0, duration=0.1, mode="track"):
    return Shot((Actuate((current, 0.0), duration), RingDown(0.02), LISTEN), mode, start)


def a_pose(place_mm=(0.0, 0.0, 50.0), sigma_mm=0.1, *, trusted=True):
    covariance = np.diag([(1e-3 * sigma_mm) ** 2] * 3 + [1e-4] * 3)
    return Pose(0.0, 1e-3 * np.array(place_mm), np.array([1.0, 0, 0, 0]), covariance, trusted=trusted)


def make_recording(shot, *, noise=1e-9, seed=0, constant=(), saturated=(), early=0.0):
    field_ = noise * np.random.default_rng(seed).standard_normal((3, 500))
    field_[list(constant)] = 3e-9
    marks = np.isin(np.arange(3), list(saturated))
    listens = next(at for at, window in shot.timed() if isinstance(window, Listen))
    return Recording(field_, 50e3, 0.02, marks, shot.excite, shot.start + listens - early)


def stops(safety, shot, now, pose, words):
    """The safety refuses the shot with these words, and from now on every other one with the same."""
    with pytest.raises(SafetyError, match=words):
        safety.check_shot(shot, now, pose)
    assert_latched(safety, words)


def assert_latched(safety, words):
    with pytest.raises(SafetyError, match=words):
        safety.check_shot(Shot((LISTEN,), "hold", 1e3), 1e3, a_pose())
    assert safety.latch.ending == "failed"


def test_a_shot_beyond_a_limit_is_stopped_with_coil_value_and_limit():
    stops(a_safety(), pulling(current=9.0), 0.0, a_pose(), r"Coil '\+x' current must lie within 0 to 8 A; got 9.00 A.")


def test_the_safety_knows_where_the_magnet_is():
    safety = a_safety()
    safety.check_shot(Shot((MoveMagnet("near", 5.0), Rotate((1, 0, 0), 0.5, 2.0))), 0.0, a_pose())
    stops(safety, Shot((LISTEN,), "hold", 10.0), 10.0, a_pose(), "needs the actuation magnet away")


def test_a_coil_that_is_driven_for_too_long_is_stopped_by_its_duty():
    safety, now, played = a_safety(rules=SafetyRules(max_duty=0.5)), 0.0, 0
    with pytest.raises(SafetyError, match=r"Coil '\+x' would be driven for 5\d % of 10 s; at most 50 % \(max_duty\)"):
        while True:
            safety.check_shot(pulling(now, duration=0.13), now, a_pose())
            now += 0.16
            played += 1
    assert played == math.floor(0.5 * 10.0 / 0.13)
    assert_latched(safety, "max_duty")


def test_a_coil_never_passes_its_temperature_for_the_shot_that_would_is_not_played():
    coil = ThermalCoil("+x", 1.0, 20.0, 8.0, limit=60.0)
    safety, now, expected = a_safety(heat=CoilHeat((coil, None, None, None), 25.0)), 0.0, 25.0
    shot = pulling()
    while True:
        after = advance_temperature(coil, expected, 64.0, 0.1, 25.0)
        if after > 60.0:
            break
        safety.check_shot(replace(shot, start=now), now, a_pose())
        now += 0.2
        expected = advance_temperature(coil, after, 0.0, 0.1, 25.0)
    assert now > 5.0
    stops(safety, replace(shot, start=now), now, a_pose(), r"Coil '\+x' would reach 60.\d °C .* at most 60 °C")


@pytest.mark.parametrize(
    ("place", "words"),
    [((30.0, 0, 50), "robot's x is 30.0"), ((0, -30.0, 50), "robot's y is -30.0"), ((0, 0, 70.0), "robot's z is 70.0")],
)
def test_a_robot_outside_the_container_stops_the_run(place, words):
    rules = SafetyRules(allowed_box=((-0.022, -0.022, 0.045), (0.022, 0.022, 0.06)))
    stops(a_safety(rules=rules), pulling(), 0.0, a_pose(place), words)


@pytest.mark.parametrize(
    "pose", [a_pose((30.0, 0, 50), 5.0), a_pose((30.0, 0, 50), trusted=False), a_pose((21.9, 0, 50))]
)
def test_a_pose_that_may_be_inside_or_is_not_trusted_stops_nothing(pose):
    a_safety(rules=SafetyRules(allowed_box=((-0.022, -0.022, 0.045), (0.022, 0.022, 0.06)))).check_shot(
        pulling(), 0.0, pose
    )


@pytest.mark.parametrize(
    "driving", [pulling(), Shot((MoveMagnet("near", 5.0), Rotate((1, 0, 0), 0.5, 2.0), MoveMagnet("away", 5.0)))]
)
def test_driving_with_an_uncertain_pose_ends_after_some_shots(driving):
    safety = a_safety(rules=SafetyRules(max_sigma=5e-3, uncertain_shots=3))
    doubtful = a_pose(sigma_mm=7.0)
    for pose in (doubtful, doubtful, a_pose(), doubtful, doubtful):
        safety.check_shot(driving, safety._time, pose)
    for _ in range(9):  # looking for it drives nothing
        safety.check_shot(Shot((Excite((1.0, 0.0), 100.0, 2), RingDown(0.02), LISTEN), "lost"), safety._time, doubtful)
    stops(
        safety, driving, safety._time, doubtful, r"Uncertain pose: .* above 5 mm .* in 3 shots in a row .* now 7.0 mm"
    )


def test_a_robot_that_was_never_located_is_not_driven_but_a_coil_may_be_learned():
    safety = a_safety()
    safety.check_shot(pulling(mode="quiet"), 0.0, None)
    stops(safety, pulling(1.0), 1.0, None, "Lost pose")


def test_windows_lost_in_a_row_are_stale_data_and_single_ones_are_counted():
    safety, shot = a_safety(rules=SafetyRules(stale_shots=3)), pulling()
    for lost in (True, False, True, True, False):
        assert (safety.check_recording(shot, None if lost else make_recording(shot), 0.2) is None) == lost
    assert safety.recovered == {"lost_windows": 3}
    safety.check_recording(shot, None, 0.2)
    safety.check_recording(shot, None, 0.2)
    with pytest.raises(SafetyError, match=r"Stale data: 3 listening windows in a row .* gave no recording"):
        safety.check_recording(shot, None, 0.2)
    assert_latched(safety, "Stale data")


def test_a_shot_that_does_not_listen_loses_no_window():
    safety = a_safety(rules=SafetyRules(stale_shots=2))
    for _ in range(5):
        assert safety.check_recording(Shot((Rotate((1, 0, 0), 0.5, 2.0),)), None, 0.0) is None
    assert safety.recovered == {"lost_windows": 0}


@pytest.mark.parametrize(
    ("early", "now", "words"),
    [
        (0.5, 0.2, r"began 0.500 s before it was requested"),
        (0.0, 3.0, r"was 2.87 s old on arrival \(max_age_ms = 1000\)"),
    ],
)
def test_a_recording_of_another_time_counts_as_lost(early, now, words):
    safety, shot = a_safety(rules=SafetyRules(stale_shots=2, max_age=1.0)), pulling()
    assert safety.check_recording(shot, make_recording(shot, early=early), now) is None
    with pytest.raises(SafetyError, match=words):
        safety.check_recording(shot, make_recording(shot, early=early), now)


@pytest.mark.parametrize(("fault", "words"), [("constant", "constant"), ("saturated", "saturated")])
def test_a_sensor_that_is_dead_or_saturated_for_some_windows_is_named(fault, words):
    shot = pulling()
    safety = a_safety(patience=3)
    for sensors in ([1], [1], [], [1, 2], [1, 2]):
        safety.check_recording(shot, make_recording(shot, **{fault: sensors}), 0.2)
    with pytest.raises(SafetyError, match=rf"Sensor 1 \(counted from 0\) was {words}.* in 3 listening windows"):
        safety.check_recording(shot, make_recording(shot, **{fault: [1]}), 0.2)
    assert_latched(safety, "Sensor 1")
    known = a_safety(patience=3, broken=[1])
    for _ in range(5):
        known.check_recording(shot, make_recording(shot, **{fault: [1]}), 0.2)


def test_a_sensor_that_repeats_a_value_is_not_dead():
    shot, safety = pulling(), a_safety(patience=1)
    spoilt = make_recording(shot)
    spoilt.field[1, [0, 250, 499]] = 7e-9
    assert safety.check_recording(shot, spoilt, 0.2) is spoilt


def test_a_coil_decay_may_saturate_and_a_world_without_samples_has_no_dead_sensors():
    safety, probe = a_safety(patience=1), pulling(mode="quiet")
    assert safety.check_recording(probe, make_recording(probe, saturated=[0]), 0.2) is not None
    empty = Recording(np.zeros((3, 0)), 50e3, 0.02, clock=0.12)
    assert safety.check_recording(pulling(), empty, 0.2) is empty


def test_the_first_reason_stays_and_what_is_bound_is_halted():
    latch, halted = Latch(), []
    latch.bind(lambda: halted.append("early"))
    assert latch.trip("first", "stopped")
    assert not latch.trip("second")
    latch.bind(lambda: halted.append("late"))
    assert (latch.reason, latch.ending) == ("first", "stopped")
    assert halted == ["early", "early", "late"]


# Complete flights.


@dataclass
class Faulty:
    """The tank behind a rig that fails at the n-th shot that `at` picks: loses windows, or does what `act` says."""

    inner: object
    at: object = lambda shot: False
    lose: range = range(0)
    act: object = None
    recovered: dict = field(default_factory=lambda: {"read_timeouts": 2})
    status_line: str = "supply 12.1 V"
    picked: int = 0
    played: list = field(default_factory=list)
    stops: int = 0

    def __getattr__(self, name):
        return getattr(self.inner, name)

    def play(self, shot):
        chosen = bool(self.at(shot))
        self.picked += chosen
        self.played.append(shot)
        if self.act is not None and chosen:
            self.act(self)
        recording = self.inner.play(shot)
        return None if chosen and self.picked - 1 in self.lose else recording

    def stop(self):
        self.stops += 1
        self.inner.stop()


@pytest.fixture(scope="module")
def brief():
    """A second of a flight with all that is learned before it."""
    more = {"localization.learn_ring_down": "true", "cycle.excite_cycles": "3", "stop.max_duration_s": "1.0"}
    return load_mission("line", settings=SHORT | more)


def flown_on(mission, folder=None, listeners=None, latch=None, real=False, **faults):
    """Fly on a faulty rig; returns the run (None where an error came out of it), the rig and that error."""
    rigs = []

    def open_faulty(mission, seed):
        world = load_world("tank", mission.rig.document)
        rigs.append(Faulty(world.open(mission.rig, mission.robot, mission.start_placement, seed), **faults))
        rigs[0].witness = None if real else rigs[0].inner.witness
        return rigs[0]

    try:
        run = fly(mission, 3, folder=folder, opener=open_faulty, make_listeners=listeners, latch=latch)
    except ValueError as error:
        return None, rigs[0], error
    return run, rigs[0], None


def is_quiet(shot):
    return shot.mode == "quiet" and len(shot.windows) == 1


def is_probe(shot):
    return shot.mode == "quiet" and shot.excite is not None


def is_tail(shot):
    return shot.mode == "quiet" and isinstance(shot.windows[0], Actuate)


def is_search(shot):
    return shot.mode == "search"


def is_track(shot):
    return shot.mode == "track"


MOMENTS = [is_quiet, is_probe, is_tail, is_search, is_track]


@pytest.mark.parametrize("moment", MOMENTS)
def test_one_lost_window_at_any_moment_ends_no_mission_and_is_counted(brief, moment):
    run, _, _ = flown_on(brief, at=moment, lose=range(1))
    assert run.status == "timeout"
    assert run.cycles[-1].tracked.trusted
    assert {c.rig for c in run.cycles} == {"supply 12.1 V"}
    assert run.summary["recovered"] == {"lost_windows": 1, "read_timeouts": 2}
    assert {e.what for e in run.events} >= {"noise learned", "ring-down learned", "coil tails learned"}


@pytest.mark.parametrize(
    ("moment", "reason"),
    [(is_quiet, "noise cannot be learned from 4 quiet shots"), (is_track, "Stale data: 3 listening windows in a row")],
)
def test_windows_lost_one_after_another_end_the_run_with_its_folder(brief, moment, reason, tmp_path):
    run, rig, _ = flown_on(brief, folder=RunFolder(tmp_path / "run"), at=moment, lose=range(1 << 30))
    assert run.status == "failed"
    assert reason in run.stop_reason
    assert rig.stops >= 1
    assert rig.picked == (4 if moment is is_quiet else 3)
    assert json.loads((tmp_path / "run/summary.json").read_text())["stop_reason"] == run.stop_reason
    assert {"mission.toml", "rig.toml", "provenance.json"} <= {p.name for p in (tmp_path / "run").iterdir()}


def test_coil_tails_whose_windows_are_lost_are_named_and_end_nothing(brief):
    run, _, _ = flown_on(brief, at=is_tail, lose=range(1 << 30))
    assert run.status == "timeout"
    (event,) = [e for e in run.events if e.what == "coil tails not learned"]
    assert event.detail == {"coils": list(brief.rig.coil_names)}


def test_shots_that_listen_only_lose_their_windows_without_harm():
    safety, held = a_safety(rules=SafetyRules(stale_shots=2)), Shot((RingDown(0.02), LISTEN), "hold", 0.0)
    shot = pulling()
    safety.check_recording(shot, None, 0.2)
    for _ in range(100):
        safety.check_recording(held, None, 0.2)
    safety.check_recording(held, make_recording(held), 0.2)  # heard, but nothing moved: the next pull is blind again
    with pytest.raises(SafetyError, match="Stale data: 2 listening windows in a row were lost"):
        safety.check_recording(shot, None, 0.2)


def test_a_ring_down_that_cannot_be_measured_keeps_the_missions_own(brief):
    run, rig, _ = flown_on(brief, at=lambda shot: is_probe(shot) and shot.excite.currents[0] != 0, lose=range(2))
    assert run.status == "timeout"
    assert "ring-down not learned" in {e.what for e in run.events}
    tracked = next(s for s in rig.played if s.mode == "track")
    assert next(w for w in tracked.windows if isinstance(w, RingDown)).duration == pytest.approx(0.02)


@pytest.mark.parametrize("moment", MOMENTS)
def test_tripping_the_latch_ends_the_run_at_any_moment_and_nothing_more_is_played(brief, moment):
    latch = Latch()

    def press(rig):
        thread = threading.Thread(target=latch.trip, args=("stopped by the operator (key)", "stopped"))
        thread.start()
        thread.join()

    run, rig, _ = flown_on(brief, latch=latch, at=moment, act=press)
    assert (run.status, run.stop_reason) == ("stopped", "stopped by the operator (key)")
    assert rig.picked == 1
    assert rig.stops >= 2


@pytest.mark.parametrize(
    ("error", "status"), [(OperatorStopError("the red button"), "stopped"), (RigError("gone"), "failed")]
)
def test_a_button_of_the_bench_stops_and_a_fault_fails(brief, error, status):
    def fail(rig):
        raise error

    run, _, _ = flown_on(brief, at=is_track, act=fail)
    assert (run.status, run.stop_reason) == (status, str(error))


def test_an_unexpected_error_is_raised_after_zero_outputs_and_a_complete_folder(brief, tmp_path):
    def listener(record):
        if record.shot.mode == "track":
            raise ValueError("a plug-in's own mistake")

    folder = tmp_path / "run"
    run, rig, error = flown_on(brief, folder=RunFolder(folder), listeners=lambda _: (listener,))
    assert run is None
    assert str(error) == "a plug-in's own mistake"
    assert rig.stops >= 1
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["status"] == "failed"
    assert summary["stop_reason"] == "ValueError: a plug-in's own mistake"
    assert len((folder / "cycles.csv").read_text().splitlines()) == 1 + summary["cycles"]


@pytest.mark.parametrize("where", ["smolbot.runs.trace.Trace.__call__", "smolbot.runs.folder.RunFolder.record"])
def test_a_stop_between_a_cycle_and_its_record_loses_no_cycle(brief, tmp_path, monkeypatch, where):
    from pydoc import locate

    owner, name = where.rsplit(".", 1)
    real, calls = getattr(locate(owner), name), []

    def interrupted(self, *arguments):
        calls.append(1)
        if len(calls) == 4:
            raise KeyboardInterrupt
        real(self, *arguments)

    monkeypatch.setattr(where, interrupted)
    run, _, _ = flown_on(brief, folder=RunFolder(tmp_path / "run"))
    assert (run.status, len(run.cycles)) == ("stopped", 4)
    assert len((tmp_path / "run/cycles.csv").read_text().splitlines()) == 1 + 4


def test_every_cycle_stands_in_the_folder_as_soon_as_it_ended(brief, tmp_path):
    lines = []

    def listener(record):
        lines.append(len((tmp_path / "run/cycles.csv").read_text().splitlines()))

    flown_on(brief, folder=RunFolder(tmp_path / "run"), listeners=lambda _: (listener,))
    assert lines == list(range(2, len(lines) + 2))


def test_a_device_that_cannot_even_be_stopped_leaves_a_record(brief):
    def fail(rig):
        rig.stop = broken
        raise RigError("no answer of Dev1")

    calls = []

    def broken():
        calls.append(1)
        if len(calls) == 1:
            raise RigError("no answer of Dev1 to zero")

    run, _, _ = flown_on(brief, at=is_track, act=fail)
    assert run.status == "failed"
    assert run.stop_reason == "no answer of Dev1; the outputs could not be set to zero: no answer of Dev1 to zero"


def test_a_run_that_is_over_plays_nothing_more(brief):
    world = load_world("tank", brief.rig.document)
    with world.open(brief.rig, brief.robot, brief.start_placement, 3) as tank:
        rig = Faulty(tank)
        loop = make_loop(rig, brief)
        first = loop.fly()
        played = len(rig.played)
        again = loop.fly()
        assert again.status == "failed"
        assert "This run is over" in again.stop_reason
        assert len(rig.played) == played
        assert first.status == "timeout"


def test_a_hot_coil_ends_a_flight_and_the_folder_has_the_reason(tmp_path):
    coils = "{ heat_capacity_j_per_k = 0.5, max_temperature_c = 40.0 }"
    hot = load_mission("line", settings={**SHORT, "rig.safety.coils": coils, "localization.estimator": "paper"})
    run = fly(hot, 3, folder=RunFolder(tmp_path / "run"))
    assert run.status == "failed"
    assert "max_temperature_c" in run.stop_reason
    assert 35.0 < max(run.summary["coil_temperature_peak_c"].values()) <= 40.0  # of the shots that were played


@pytest.mark.parametrize(
    "setting",
    [
        "safety.max_duty = 1.5",
        "safety.stale_shots = 1",
        "safety.max_temp_c = 3",
        "safety.coils.heat_capacity_j_per_k = -1",
    ],
)
def test_a_wrong_key_is_a_fault_of_the_rig_file(setting):
    from smolbot.errors import ConfigError

    key, _, value = setting.partition(" = ")
    with pytest.raises(ConfigError, match=f"--set rig.{key}"):
        load_rig("tank", {key: value})


def without_safety(mission, seed):
    world = load_world("tank", mission.rig.document)
    place = getattr(mission, "start_placement", None) or mission.start
    rig = world.open(mission.rig, mission.robot, place, seed)
    loop = make_loop(rig, mission)
    loop.safety = make_limits_only_safety(rig.limits, len(rig.sensors))
    run = loop.fly()
    rig.close()
    return run


def same_flight(one, other):
    assert (one.status, one.stop_reason, len(one.cycles)) == (other.status, other.stop_reason, len(other.cycles))
    for a, b in zip(one.cycles, other.cycles):
        assert a.shot == b.shot
        assert (a.pose is None) == (b.pose is None)
        if a.pose is not None:
            assert np.array_equal(a.pose.position, b.pose.position)
            assert np.array_equal(a.pose.orientation, b.pose.orientation)


def test_the_safety_changes_no_pose_and_no_command(brief):
    same_flight(fly(brief, 3), without_safety(brief, 3))


SHIPPED = ["r_path", "r_small", "s_path", "s_path_blocked", "endoscope", "brain_marker"]


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_no_shipped_mission_is_stopped_or_changed(name):
    mission = load_mission(name)
    for seed in (1, 2, 3):
        run = fly(mission, seed)
        assert run.status == "completed"
        same_flight(run, without_safety(mission, seed))


@pytest.mark.parametrize("name", ["tank", "gel", "gel_blocked", "kidney", "brain"])
def test_every_shipped_rig_has_thermal_constants_of_its_coils(name):
    rig = load_rig(name)
    assert "safety" in rig.document.data
    assert all(coil is not None for coil in rig.thermal)
    for coil in rig.thermal:  # a burst or a pull as long as allowed heats by a few degrees, not by tens
        limits = rig.limits
        square, longest = (
            (0.5 * limits.max_excitation_current**2, limits.max_excitation)
            if coil.name.startswith("excitation")
            else (limits.max_current**2, limits.max_actuation)
        )
        assert advance_temperature(coil, 25.0, square, longest, 25.0) < 27.0


def test_a_rig_file_without_the_section_is_watched_all_the_same(brief):
    mission = load_mission("line", settings=SHORT)
    del mission.rig.document.data["safety"]
    from smolbot.config.rig import RigConfig
    from smolbot.config.rig_sections import RigFile

    sections, faults = mission.rig.document.validate(RigFile)
    assert faults == []
    mission.rig = RigConfig(mission.rig.document, sections)
    world = load_world("tank", mission.rig.document)
    with world.open(mission.rig, mission.robot, mission.start_placement, 3) as rig:
        safety = make_safety(rig, mission)
    assert safety.heat.coils[0].capacity == pytest.approx(58.6, abs=0.1)
    assert safety.rules.allowed_box[1][0] == pytest.approx(0.025)


def test_a_bench_remembers_how_hot_its_coils_are_and_a_tank_does_not(brief, cold_coils):
    assert flown_on(brief)[0].summary["coil_temperature_begin_c"]["+x"] == 25.0
    assert not cold_coils.exists()
    first, second = (flown_on(brief, real=True)[0].summary for _ in range(2))
    assert first["coil_temperature_begin_c"]["+x"] == 25.0
    assert 25.0 < second["coil_temperature_begin_c"]["+x"] <= first["coil_temperature_peak_c"]["+x"]
    assert [p.name for p in cold_coils.iterdir()] == ["tank.json"]
