"""Flying: same seed, same flight; the truth is not needed; however a flight ends, all outputs are at zero."""

from __future__ import annotations

import json
import threading
from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest

import smolbot
from smolbot.config.mission import load_steering_mission
from smolbot.config.plugins import load_world
from smolbot.core.sensing import Recording
from smolbot.core.shots import Actuate, Excite, Listen, RingDown, Rotate, Shot
from smolbot.errors import ConfigError, InputError, InterlockError, PluginError, RigError, SmolbotError
from smolbot.flight import session as flying
from smolbot.flight.assembly import make_loop
from smolbot.flight.loop import Loop
from smolbot.flight.session import LEARNED_SENSORS_FILE, fly
from smolbot.runs.folder import RunFolder

FILES = {
    *("mission.toml", "rig.toml", "robot.toml", "provenance.json", "cycles.csv", "summary.json"),
    *("path.png", "run.mcap", LEARNED_SENSORS_FILE),
}
WALL = ("wall_s", "compute_ms", "realtime_factor", "run", "recording")
SHORT = {"path.points_mm": "[[-1.0, 0.0], [1.5, 0.0]]", "start.offset_mm": "[-0.5, 0.3]", "localization.quiet_s": "2.0"}


@pytest.fixture(scope="module")
def short():
    return load_steering_mission("line", settings=SHORT)


@pytest.fixture(scope="module")
def plain():
    """The same, by the paper's estimator, which needs no noise to be learned first: for tests of the loop itself."""
    return load_steering_mission("line", settings={**SHORT, "localization.estimator": "paper", "stop.lost_s": "4.0"})


@pytest.fixture(scope="module")
def flown(short, tmp_path_factory):
    """One short flight with everything on, and its folder."""
    folder = tmp_path_factory.mktemp("flight") / "run"
    return fly(short, 3, folder=RunFolder(folder), settings=SHORT), folder


def timeless(summary):
    return {key: value for key, value in summary.items() if key not in WALL}


def test_a_short_line_is_flown_to_its_end(flown, short):
    run, _ = flown
    assert run.status == "completed"
    assert run.summary["verdict"] == "passed"
    last = run.true_trail[-1]
    assert np.linalg.norm(last[:2] - short.path.points[-1][:2]) < 2e-3
    assert run.summary["tracking_error_mm"]["mean"] < 1.0
    assert run.summary["localization_error_mm"]["mean"] < 1.0


def test_the_same_seed_twice_gives_the_same_summary_but_for_wall_time(flown, short):
    again = fly(short, 3, settings=SHORT)
    assert json.dumps(timeless(again.summary)) == json.dumps(timeless(flown[0].summary))


def test_another_seed_gives_another_flight(flown, short):
    other = fly(short, 4, settings=SHORT)
    assert other.summary["duration_s"] != flown[0].summary["duration_s"]


def test_without_the_witness_poses_and_commands_are_the_same_bit_for_bit(flown, short):
    seen, unseen = flown[0], fly(short, 3, witness=False)
    assert len(seen.cycles) == len(unseen.cycles)
    for a, b in zip(seen.cycles, unseen.cycles, strict=True):
        assert a.shot == b.shot
        assert a.command == b.command
        assert np.array_equal(a.pose.position, b.pose.position)
        assert np.array_equal(a.pose.orientation, b.pose.orientation)
        assert np.array_equal(a.pose.covariance, b.pose.covariance)
        assert np.array_equal(a.tracked.position, b.tracked.position)
    assert unseen.true_trail is None
    assert not {"localization_error_mm", "tracking_error_mm", "flips"} & set(unseen.summary)


def test_a_run_folder_holds_files_provenance_cycles_summary_and_picture(flown):
    run, folder = flown
    assert {p.name for p in folder.iterdir()} == FILES
    assert (folder / "path.png").read_bytes().startswith(b"\x89PNG")
    rows = (folder / "cycles.csv").read_text().splitlines()
    assert len(rows) == 1 + len(run.cycles)
    origin = json.loads((folder / "provenance.json").read_text())
    assert origin["seed"] == 3
    assert origin["settings"] == SHORT
    assert origin["world"]["truth"]
    assert json.loads((folder / "summary.json").read_text())["status"] == "completed"


def test_a_run_can_be_flown_again_from_its_own_folder(flown, tmp_path):
    _, folder = flown
    text = (folder / "mission.toml").read_text()
    for key, own in (("rig", "rig.toml"), ("robot", "robot.toml")):
        name = {"rig": "tank", "robot": "gradient"}[key]
        text = text.replace(f'{key} = "{name}"', f'{key} = "{own}"')
        (tmp_path / own).write_text((folder / own).read_text())
    (tmp_path / "mission.toml").write_text(text)
    again = fly(load_steering_mission(str(tmp_path / "mission.toml")), 3)
    assert json.dumps(timeless(again.summary)) == json.dumps(timeless(flown[0].summary))


def test_every_figure_that_programs_read_is_in_the_summary(flown):
    wanted = {
        "status", "stop_reason", "cycles", "duration_s", "loop_rate_hz", "timeline_limit_hz", "compute_ms",
        "localization_error_mm", "orientation_error_deg", "tracking_error_mm", "r_squared_median", "flips",
        "coil_energy_j", "wall_s", "realtime_factor", "verdict", "run",
    }  # fmt: skip
    summary = flown[0].summary
    assert wanted <= set(summary)
    assert set(summary["localization_error_mm"]) >= {"mean", "std", "p95"}
    assert set(summary["tracking_error_mm"]) >= {"mean", "rms", "p95", "max"}
    assert set(summary["orientation_error_deg"]) >= {"mean", "p95"}
    assert set(summary["compute_ms"]) >= {"median", "p99"}


def test_figures_of_the_summary_follow_from_the_cycles(flown, short):
    run, s = flown[0], flown[0].summary
    assert s["cycles"] == len(run.cycles)
    assert s["loop_rate_hz"] == pytest.approx(len(run.cycles) / (run.duration - run.begun))
    played = sum(c.shot.duration for c in run.cycles)
    assert s["timeline_limit_hz"] == pytest.approx(len(run.cycles) / played)
    assert run.duration - run.begun == pytest.approx(played + len(run.cycles) * short.rig.turnaround)
    acts = [w for c in run.cycles for w in c.shot.windows if isinstance(w, Actuate)]
    heat = sum(
        w.duration * sum(r * c**2 for r, c in zip(short.rig.coil_resistances, w.currents, strict=True)) for w in acts
    )
    assert s["coil_energy_j"] == pytest.approx(heat)
    assert s["loop_rate_hz"] >= 0.97 * s["timeline_limit_hz"]


def test_no_shot_of_a_flight_pulls_before_two_poses_agree_and_all_keep_the_limits(flown, short):
    run = flown[0]
    assert [c.shot.mode for c in run.cycles[:2]] == ["search", "hold"]
    for cycle in run.cycles:
        assert short.rig.limits.faults(cycle.shot) == []


def test_a_notebook_flies_with_settings_and_the_same_errors(tmp_path):
    run = smolbot.run("line", seed=3, out=tmp_path / "a", report=False, force="preview", stop__max_duration_s=1.0,
                      path__points_mm=[[-1, 0], [1, 0]], localization__quiet_s=0.0)  # fmt: skip
    assert run.status == "timeout"
    assert run.stop_reason == "max_duration_s reached after 1 s"
    assert run.summary["verdict"] == "failed"
    assert run.folder == str(tmp_path / "a")
    with pytest.raises(ConfigError, match="Did you mean tolerance_mm"):
        smolbot.run("line", controller__tolerence_mm=0.5)
    with pytest.raises(InputError, match="not empty"):
        smolbot.run("line", out=tmp_path / "a")
    with pytest.raises(InputError, match="overrides belong to loading"):
        smolbot.run(load_steering_mission("line"), rig="tank")


def test_a_used_run_folder_is_refused_and_left_as_it_is(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="not empty"):
        RunFolder(tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]
    with pytest.raises(InputError, match="is a file"):
        RunFolder(tmp_path / "notes.txt")


class Interrupt:
    """Ctrl-C during the n-th cycle."""

    def __init__(self, after: int) -> None:
        self.left = after

    def __call__(self, record) -> None:
        self.left -= 1
        if self.left == 0:
            raise KeyboardInterrupt


def test_ctrl_c_stops_cleanly_with_a_complete_folder(plain, tmp_path):
    run = fly(plain, 3, folder=RunFolder(tmp_path / "run"), make_listeners=lambda _: (Interrupt(5),))
    assert run.status == "stopped"
    assert "Ctrl-C" in run.stop_reason
    assert {p.name for p in (tmp_path / "run").iterdir()} == FILES - {LEARNED_SENSORS_FILE}
    assert json.loads((tmp_path / "run/summary.json").read_text())["status"] == "stopped"
    assert len((tmp_path / "run/cycles.csv").read_text().splitlines()) == 1 + 5


@dataclass
class Wrapped:
    """A rig around the tank that may spoil recordings, may fail, and notes what it played."""

    inner: object
    spoil: object = None
    fail_at: int | None = None
    error: Exception = field(default_factory=lambda: RigError("the amplifier tripped"))
    played: int = 0
    stops: int = 0

    def __getattr__(self, name):
        return getattr(self.inner, name)

    def play(self, shot):
        self.played += shot.mode != "quiet"
        if self.fail_at == self.played:
            raise self.error
        recording = self.inner.play(shot)
        spoils = self.spoil and recording is not None and recording.drive
        return self.spoil(self.played, recording) if spoils else recording

    def stop(self):
        self.stops += 1
        self.inner.stop()


@pytest.fixture
def fly_wrapped(monkeypatch):
    """Fly a mission on a rig that is wrapped; returns the run and the wrapper."""

    def go(mission, **options):
        wraps = []

        def world(name, document):
            real = load_world(name, document)

            def open_wrapped(*args, **kwargs):
                wraps.append(Wrapped(real.open(*args, **kwargs), **options))
                return wraps[0]

            return SimpleNamespace(open=open_wrapped, check=real.check)

        monkeypatch.setattr(flying, "load_world", world)
        folder = options.pop("folder", None)
        return fly(mission, 3, folder=folder), wraps[0]

    return go


def noise_only(recording: Recording, number: int) -> Recording:
    noise = 1e-10 * np.random.default_rng(number).normal(size=recording.field.shape)
    return replace(recording, field=noise)


@pytest.mark.parametrize("error", [RigError("the amplifier tripped"), InterlockError("Nothing was played.")])
def test_a_failing_rig_ends_the_flight_with_its_reason(plain, fly_wrapped, tmp_path, error):
    run, rig = fly_wrapped(plain, fail_at=4, error=error, folder=RunFolder(tmp_path / "run"))
    assert run.status == "failed"
    assert run.stop_reason == str(error)
    assert run.summary["verdict"] == "failed"
    assert rig.stops >= 1
    assert len(run.cycles) == 3
    assert {p.name for p in (tmp_path / "run").iterdir()} == FILES - {LEARNED_SENSORS_FILE}


def test_an_unexpected_error_of_a_labs_rig_names_the_rig_and_leaves_outputs_at_zero(
    plain, fly_wrapped, tmp_path, monkeypatch
):
    stopped = []
    monkeypatch.setattr(Wrapped, "stop", lambda self: stopped.append(self) or self.inner.stop())
    with pytest.raises(PluginError, match=r"Rig \S*:Wrapped failed in play\(\): KeyError: 'gone' \(.*\.py:\d+\)"):
        fly_wrapped(plain, fail_at=4, error=KeyError("gone"), folder=RunFolder(tmp_path / "run"))
    assert stopped
    summary = json.loads((tmp_path / "run/summary.json").read_text())
    assert (summary["status"], summary["cycles"]) == ("failed", 3)
    assert "Wrapped failed in play()" in summary["stop_reason"]


def test_a_rig_that_fails_at_once_still_leaves_a_folder(plain, fly_wrapped, tmp_path):
    run, _ = fly_wrapped(plain, fail_at=1, folder=RunFolder(tmp_path / "run"))
    assert run.status == "failed"
    assert run.cycles == []
    assert {p.name for p in (tmp_path / "run").iterdir()} >= FILES - {"cycles.csv", LEARNED_SENSORS_FILE}


def test_a_signal_that_was_never_there_is_searched_for_and_then_given_up(plain, fly_wrapped):
    run, _ = fly_wrapped(plain, spoil=lambda n, recording: noise_only(recording, n))
    assert run.status == "lost"
    assert "never found" in run.stop_reason
    assert len(run.cycles) >= plain.sections.stop.lost_shots
    assert run.cycles[-2].ended - run.begun < plain.sections.stop.lost_s <= run.cycles[-1].ended - run.begun
    assert {c.shot.mode for c in run.cycles} == {"search"}
    bursts = {(np.sign(c.shot.excite.currents[0]), np.sign(c.shot.excite.currents[1])) for c in run.cycles}
    assert len(bursts) == 4
    cycles = [c.shot.excite.cycles for c in run.cycles]
    assert cycles[-1] > cycles[0]
    assert all(c.command.window is None for c in run.cycles)


def test_a_signal_that_is_lost_stops_the_pulling_and_then_the_mission(plain, fly_wrapped):
    run, _ = fly_wrapped(plain, spoil=lambda n, recording: recording if n <= 8 else noise_only(recording, n))
    assert run.status == "lost"
    assert "was lost" in run.stop_reason
    modes = [c.shot.mode for c in run.cycles]
    first = modes.index("lost")
    assert set(modes[first:]) == {"lost"}
    assert first - 8 <= 4
    acts = [any(isinstance(w, Actuate) for w in c.shot.windows) for c in run.cycles]
    assert not any(acts[first:])


def test_a_signal_that_comes_back_is_found_again_and_the_mission_completes(short, fly_wrapped):
    run, _ = fly_wrapped(short, spoil=lambda n, recording: noise_only(recording, n) if 8 < n <= 16 else recording)
    assert run.status == "completed"
    modes = [c.shot.mode for c in run.cycles]
    assert "lost" in modes
    assert modes[-1] == "track"


def test_a_short_glitch_of_the_sensors_is_flown_through(plain, fly_wrapped):
    def saturate(n, recording):
        return replace(recording, saturated=np.ones(10, dtype=bool)) if n in (9, 14) else recording

    run, _ = fly_wrapped(plain, spoil=saturate)
    assert run.status == "completed"
    assert sum(c.pose is None for c in run.cycles) == 2
    assert "lost" not in {c.shot.mode for c in run.cycles}


def test_pause_holds_the_robot_and_resume_lets_it_go_on(plain):
    world = load_world("tank", plain.rig.document)
    rig = world.open(plain.rig, plain.robot, plain.start, 3)
    modes: list[str] = []
    loop: Loop

    def pause(record):
        modes.append(record.shot.mode)
        loop.pause.held = 10 <= len(modes) < 20

    loop = make_loop(rig, plain, (pause,))
    run = loop.fly()
    rig.close()
    assert run.status == "completed"
    assert modes[10:20] == ["hold"] * 10
    assert modes[20] == "track"
    noted = [(event.what, modes_before(run, event.time)) for event in run.events if event.what in ("paused", "resumed")]
    assert noted == [("paused", 10), ("resumed", 20)]


def modes_before(run, time):
    """How many cycles had begun before `time` s."""
    return sum(cycle.shot.start < time - 1e-9 for cycle in run.cycles)


def test_time_in_a_pause_does_not_count_towards_the_longest_duration(plain):
    held = 25.0

    def pause(record):
        loop.pause.held = 2.0 <= record.shot.end - begun[0] < 2.0 + held if begun else not begun.append(record.shot.end)

    begun: list[float] = []
    brief = load_steering_mission("line", settings={**SHORT, "stop.max_duration_s": "20"})
    rig = load_world("tank", brief.rig.document).open(brief.rig, brief.robot, brief.start, 3)
    loop = make_loop(rig, brief, (pause,))
    run = loop.fly()
    rig.close()
    assert run.status == "completed"
    assert run.duration - run.begun > held


def test_a_controller_that_learns_is_notified_of_a_command_that_was_not_played(plain):
    rig = load_world("tank", plain.rig.document).open(plain.rig, plain.robot, plain.start, 3)
    noted: list[int] = []

    def pause(record):
        loop.pause.held = 10 <= len(loop.run.cycles) < 20

    loop = make_loop(rig, plain, (pause,))
    loop.pilot.controller.unplayed = lambda: noted.append(len(loop.run.cycles))
    loop.fly()
    rig.close()
    assert noted == list(range(10, 20))


def test_a_sensor_that_becomes_noisy_on_the_way_is_found_and_weighed_less(fly_wrapped):
    rng = np.random.default_rng(0)

    def noisy(n, recording):
        field = recording.field.copy()
        field[5] += 4e-9 * rng.standard_normal(field.shape[1])
        return replace(recording, field=field)

    settings = {"path.points_mm": "[[-5.0, 0.0], [5.0, 0.0]]", "rig.tank.mismatch.scale": "0"}
    run, _ = fly_wrapped(load_steering_mission("line", settings=SHORT | settings), spoil=noisy)
    ratios = [e.detail["power_ratios"] for e in run.events if e.what == "noise refreshed"]
    assert run.status == "completed"
    assert np.argmax(ratios[0]) == 5
    assert ratios[0][5] > 3.0


class RigContract:
    """What every rig promises. Inherit it and give ``rig``: an open one, with a robot in reach."""

    CYCLE = Shot((Excite((6.0, 6.0), 103.5, 5), RingDown(0.02), Listen(2, 103.5)))

    def outputs(self, rig) -> np.ndarray:
        """Commanded currents of every driven coil, now."""
        raise NotImplementedError

    def test_it_says_what_it_is(self, rig):
        from smolbot.core.rig import Rig

        assert isinstance(rig, Rig)
        assert len(rig.sensors) > 0
        assert rig.limits.coils
        field_ = rig.excitation_field(np.array([0.0, 0.0, 0.06]))
        assert field_.shape[1] == 3
        assert np.isfinite(field_).all()

    def test_a_recording_has_every_sensor_and_the_complete_window(self, rig):
        for half_periods in (1, 2, 20):
            listen = Listen(half_periods, 103.5)
            recording = rig.play(replace(self.CYCLE, windows=(*self.CYCLE.windows[:2], listen)))
            assert recording.field.shape == (len(rig.sensors), round(listen.duration * recording.sample_rate))
            assert recording.saturated.shape == (len(rig.sensors),)
            assert recording.drive == self.CYCLE.excite
            assert recording.time_since_drive == pytest.approx(0.02, abs=1e-4)

    def test_a_shot_that_listens_to_nothing_returns_none(self, rig):
        assert rig.play(Shot((Actuate((1.0, 0, 0, 0), 0.01),))) is None

    def test_a_noise_recording_follows_no_drive(self, rig):
        recording = rig.play(Shot((Listen(2, 103.5),), mode="quiet"))
        assert recording.drive is None
        assert recording.time_since_drive == np.inf

    def test_its_clock_goes_on_by_at_least_what_was_played(self, rig):
        before = rig.now()
        recording = rig.play(self.CYCLE)
        assert rig.now() >= before + self.CYCLE.duration - 1e-9
        assert before < recording.clock < recording.middle < rig.now()

    @pytest.mark.parametrize(
        "windows",
        [
            (Actuate((99.0, 0, 0, 0), 0.01),),
            (Actuate((1.0, 0, 0), 0.01),),
            (Excite((99.0, 0.0), 103.5, 5),),
            (Excite((1.0, 0.0), 103.5, 5), Listen(2, 103.5)),
            (Rotate((0, 0, 1), 99.0, 1.0),),
        ],
    )
    def test_a_shot_beyond_a_limit_is_refused_before_anything_moves(self, rig, windows):
        before = rig.now()
        with pytest.raises(InterlockError, match="Nothing was played"):
            rig.play(Shot(windows))
        assert rig.now() == pytest.approx(before, abs=0.5)
        assert not self.outputs(rig).any()

    def test_after_every_shot_every_output_is_at_zero(self, rig):
        rig.play(Shot((Actuate((3.0, 0, 2.0, 0), 0.02),)))
        assert not self.outputs(rig).any()

    def test_stop_from_another_thread_ends_a_shot_with_every_output_at_zero(self, rig):
        long = Shot((Actuate((3.0, 0, 0, 0), 0.1),) * 40)
        started, failures = threading.Event(), []

        def play():
            started.set()
            try:
                while True:
                    rig.play(long)
            except RigError as error:
                failures.append(error)

        thread = threading.Thread(target=play)
        thread.start()
        started.wait()
        while thread.is_alive():  # a stop between two shots ends none: ask until one is hit
            rig.stop()
            thread.join(1e-3)
        assert len(failures) == 1
        assert not self.outputs(rig).any()
        assert rig.play(self.CYCLE) is not None

    def test_stop_and_close_may_be_repeated(self, rig):
        for _ in range(3):
            rig.stop()
        for _ in range(2):
            rig.close()
        with pytest.raises(SmolbotError):
            rig.play(self.CYCLE)


class TestTankKeepsTheContract(RigContract):
    @pytest.fixture
    def rig(self, line):
        world = load_world("tank", line.rig.document)
        opened = world.open(line.rig, line.robot, line.start, 1)
        yield opened
        opened.close()

    def outputs(self, rig):
        coils = rig._tank.coils
        return coils.circuits[: coils.n_actuation + coils.n_excitation, 1:3]
