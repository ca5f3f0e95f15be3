"""The array is calibrated from a known track, and poses located with the file that is written are better for it."""

from __future__ import annotations

import json
import sys
import tomllib

import numpy as np
import pytest

from sim.tank.positioning_stage import TankStage
from smolbot.config.known_track import plan_track, read_known_track, write_known_track
from smolbot.config.mission import load_steering_mission
from smolbot.config.rig import load_rig
from smolbot.config.robot import load_robot
from smolbot.core.pose import Pose
from smolbot.core.rotations import quaternion_from_axes
from smolbot.errors import ConfigError, InputError, MissingFileError
from smolbot.localization.localizer import Localizer
from smolbot.runs.folder import RunFolder
from smolbot.runs.recording.run_files import RunFiles
from smolbot.ui.cli.app import main

SEED, POSES = 3, 48
SOME = 24  # of them, where less will do
ACROSS = "x_mm,y_mm,z_mm,along_x,along_y,along_z,swing_x,swing_y,swing_z"


def run(monkeypatch, capsys, *arguments):
    """Exit code and what was printed on standard output and standard error."""
    monkeypatch.setattr(sys, "argv", ["smolbot", "calibrate-array", "--rig", "tank", *map(str, arguments)])
    with pytest.raises(SystemExit) as left:
        main()
    printed = capsys.readouterr()
    return left.value.code, printed.out, printed.err


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    """A tank calibrated on its own stage: folder with sensors.toml, track and samples, and what was printed."""
    folder = tmp_path_factory.mktemp("stage")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(
            sys, "argv",
            ["smolbot", "calibrate-array", "--rig", "tank", "--seed", str(SEED), "--poses", str(POSES), "--keep",
             "kept", "--json", "--out", "sensors.toml"],
        )  # fmt: skip
        text: list[str] = []
        patch.setattr(sys.stdout, "write", text.append)
        with pytest.raises(SystemExit) as left:
            main()
    return folder, left.value.code, json.loads("".join(text))


def few(stage, folder):
    """The first recordings alone, as ``samples.npz`` in `folder`; what that file holds."""
    with np.load(stage[0] / "kept" / "samples.npz") as held:
        values = {
            name: value[:SOME] if np.ndim(value) and len(value) == POSES else value for name, value in held.items()
        }
    np.savez(folder / "samples.npz", **values)
    return values


@pytest.fixture
def calibrated(stage):
    return load_rig("tank", {"sensors.calibrated": str(stage[0] / "sensors.toml")})


def test_held_out_poses_come_out_better_and_are_told(stage):
    folder, code, told = stage
    assert code == 0
    assert told["verdict"] == "passed"
    assert told["held_out"] == POSES // 4
    assert told["held_out_position_mm"]["after"] < 0.7 * told["held_out_position_mm"]["before"]
    written = tomllib.loads((folder / "sensors.toml").read_text())
    assert written["uncertainty"]["position_mm"][1] == pytest.approx(told["held_out_position_mm"]["after"], rel=1e-5)


def test_new_places_in_the_same_tank_are_located_better_with_the_file_that_was_written(calibrated):
    """Poses of no part in the calibration, in the tank with its mismatches: 0.2 mm, 0.5 %, 0.3 degrees."""
    device, errors = load_robot("gradient").device, {}
    rng = np.random.default_rng(5)
    places = np.column_stack([rng.uniform(-0.015, 0.015, (12, 2)), np.full(12, 0.06)])
    turn = quaternion_from_axes(np.array([0.6, 0.8, 0.0]), np.array([0.0, 0.0, 1.0]), "zy")
    for name, rig in (("nominal", load_rig("tank")), ("calibrated", calibrated)):
        bench = TankStage(rig, device, SEED).bench
        known = Localizer(rig.sensors, bench.true_device)
        found = [known.locate(bench.record(p, turn, 6), Pose(0.0, p, turn, np.eye(6))).position for p in places]
        errors[name] = np.sqrt(np.mean((found - places) ** 2))
    assert errors["calibrated"] < 0.7 * errors["nominal"]


def test_what_is_claimed_of_the_places_is_true(stage, calibrated):
    true = TankStage(load_rig("tank"), load_robot("gradient").device, SEED).bench.true_sensors
    claimed = 1e-3 * np.array(stage[2]["positions_mm"]["std"])
    score = (calibrated.sensors.positions - true.positions) / claimed
    assert 0.5 < np.sqrt(np.mean(score**2)) < 1.8
    off = calibrated.sensors.positions - true.positions
    assert np.sqrt(np.mean(off**2)) < 0.7 * np.sqrt(np.mean((load_rig("tank").sensors.positions - true.positions) ** 2))


def test_the_device_need_not_sit_straight_in_its_holder(stage):
    holder = TankStage(load_rig("tank"), load_robot("gradient").device, SEED).holder
    told = stage[2]
    assert told["holder_mm"]["value"][:2] == pytest.approx(1e3 * holder[:2], abs=0.1)  # l0 is a little off along z
    assert told["holder_deg"]["value"][1:] == pytest.approx(np.degrees(holder[4:]), abs=0.1)


def test_a_lab_with_the_same_recordings_finds_the_same(stage, tmp_path, monkeypatch, capsys):
    out = tmp_path / "mine.toml"
    code, printed, _ = run(monkeypatch, capsys, stage[0] / "kept" / "track.csv", "--out", out, "--json")
    assert code == 0
    told = json.loads(printed)
    assert told["positions_mm"]["value"] == pytest.approx(np.array(stage[2]["positions_mm"]["value"]), abs=1e-4)
    assert load_rig("tank", {"sensors.calibrated": str(out)}).sensor_gains == pytest.approx(told["gains"]["value"])


def test_the_tank_stays_as_it_was_built_whatever_is_believed_of_it(calibrated):
    device = load_robot("gradient").device
    before, after = (TankStage(rig, device, SEED) for rig in (load_rig("tank"), calibrated))
    assert np.array_equal(before.bench.true_sensors.positions, after.bench.true_sensors.positions)
    place, turn = np.array([0.0, 0.0, 0.06]), np.array([1.0, 0.0, 0.0, 0.0])
    first, second = (s.record(place, turn, 2).field for s in (before, after))
    assert second * calibrated.sensor_gains[:, None] == pytest.approx(first)


def test_the_section_can_be_pasted_into_a_rig_file(stage, calibrated, tmp_path):
    section = (stage[0] / "sensors.toml").read_text().split("\n[sensors]\n")[1].split("[uncertainty]")[0]
    rig = load_rig("tank").document.text
    begin, end = rig.index("[sensors]"), rig.index("[[coils]]")
    (tmp_path / "mine.toml").write_text(rig[:begin] + "[sensors]\n" + section + rig[end:])
    pasted = load_rig(str(tmp_path / "mine.toml"))
    assert pasted.sensors.positions == pytest.approx(calibrated.sensors.positions)
    assert pasted.sensor_gains == pytest.approx(calibrated.sensor_gains)


def test_a_run_keeps_the_sensors_file_that_it_believed(stage, tmp_path):
    mission = load_steering_mission("line", None, {"rig.sensors.calibrated": str(stage[0] / "sensors.toml")})
    RunFolder(tmp_path / "run").begin(RunFiles.of(mission).contents, {})
    assert (tmp_path / "run" / "sensors.toml").read_text() == (stage[0] / "sensors.toml").read_text()


def test_rows_that_do_not_belong_to_their_recordings_fail_the_check_and_nothing_is_written(
    stage, tmp_path, monkeypatch, capsys
):
    track = read_known_track(stage[0] / "kept" / "track.csv")
    few(stage, tmp_path)
    write_known_track(tmp_path / "wrong.csv", track.poses[:SOME][::-1], ["samples.npz"] * SOME)
    out = tmp_path / "s.toml"
    code, printed, error = run(monkeypatch, capsys, tmp_path / "wrong.csv", "--out", out, "--json")
    assert code == 1
    assert json.loads(printed)["sensors_file"] is None
    assert not out.exists()
    assert "do rows and recordings belong together" in error


def test_recordings_of_no_use_are_named_and_left_out(stage, tmp_path, monkeypatch, capsys):
    track = read_known_track(stage[0] / "kept" / "track.csv")
    values = few(stage, tmp_path)
    values["volts"][5] = 1e-4 * np.random.default_rng(0).standard_normal(values["volts"][5].shape)
    values["volts"][9, :8, 100] = 10.0
    values["volts"][12, 4] = 0.5
    np.savez(tmp_path / "spoilt.npz", **values)
    write_known_track(tmp_path / "t.csv", track.poses[:SOME], [""] * SOME)
    code, printed, _ = run(
        monkeypatch, capsys, tmp_path / "t.csv", "--samples", tmp_path / "spoilt.npz", "--json", "--out",
        tmp_path / "s.toml",
    )  # fmt: skip
    told = json.loads(printed)
    assert (code, told["recordings"]) == (0, SOME - 2)
    notes = "\n".join(told["notes"])
    assert "spoilt.npz, shot 5: left out: nothing rings" in notes
    assert "spoilt.npz, shot 9: left out: Only 2 channels" in notes
    assert "spoilt.npz, shot 12: left out: dead (constant) channel 4" in notes


def test_sensors_files_of_other_rigs_are_refused(stage, tmp_path):
    text = (stage[0] / "sensors.toml").read_text()
    for old, new, says in (
        (
            'rig = "tank"',
            'rig = "bench"',
            r":\d+: rig: these .* on rig 'bench'; asked for is 'tank'",
        ),
        ("sensitivity_v_per_ut = 1.0", "sensitivity_v_per_ut = 0.1", r"sensitivity_v_per_ut: was 0\.1 in the calibr"),
        ("gains = [\n", "gains = [\n    1.0,\n", "10 positions_mm but 11 gains"),
    ):
        assert text.count(old) >= 1
        (tmp_path / "s.toml").write_text(text.replace(old, new, 1))
        with pytest.raises(ConfigError, match=says):
            load_rig("tank", {"sensors.calibrated": str(tmp_path / "s.toml")})
    with pytest.raises(MissingFileError, match="none.toml: no such file"):
        load_rig("tank", {"sensors.calibrated": "none.toml"})


ROW = "0,0,60,0,1,0,1,0,0"
BAD_TRACKS = {
    "empty": ("", "holds no track"),
    "names only": (ACROSS, "holds no track"),
    "no place": ("x_mm,y_mm,qw,qx,qy,qz\n0,0,1,0,0,0", "column z_mm is missing"),
    "no orientation": ("x_mm,y_mm,z_mm\n0,0,60", "no orientation; a track needs x_mm"),
    "text": (f"{ACROSS}\n{ROW}\n0,zero,60,0,1,0,1,0,0", r"t\.csv:3: y_mm is not a number \('zero'\)"),
    "nan": (f"{ACROSS}\n{ROW.replace('60', 'nan')}", r"t\.csv:2: z_mm is not a number \('nan'\)"),
    "short row": (f"# a lab\n{ACROSS}\n0,0,60", r"t\.csv:3: has 3 columns; the line of names has 9"),
    "same": (f"{ACROSS}\n0,0,60,0,1,0,0,1,0", r"t\.csv:2: along and swing must be two directions at right angles"),
    "long": (
        "x_mm,y_mm,z_mm,qw,qx,qy,qz\n0,0,60,1,1,0,0",
        r"t\.csv:2: qw, .* must be of unit length; got 1\.414",
    ),
    "nameless": (f"{ACROSS}\n{ROW}", "row 1 names no samples; give a column 'file', or one file by --samples"),
    "no samples": (f"{ACROSS},file\n{ROW},none.npz", r"none\.npz: no such file"),
}


@pytest.mark.parametrize("case", BAD_TRACKS)
def test_bad_tracks_are_refused_with_line_and_column(tmp_path, monkeypatch, capsys, case):
    text, says = BAD_TRACKS[case]
    (tmp_path / "t.csv").write_text(text)
    code, _, error = run(monkeypatch, capsys, tmp_path / "t.csv")
    assert code == 2
    assert error.count("\n") == 1
    with pytest.raises(InputError, match=says):
        raise InputError(error)


def test_an_array_that_stands_where_it_is_believed_to_is_left_alone(tmp_path, monkeypatch, capsys):
    out = tmp_path / "s.toml"
    code, printed, _ = run(
        monkeypatch, capsys, "--seed", 4, "--set", "rig.tank.mismatch.scale=0.0", "--out", out, "--json"
    )
    told = json.loads(printed)
    assert (code, told["verdict"], told["sensors_file"], out.exists()) == (1, "failed", None, False)
    spread = np.array(told["positions_mm"]["value"]) - 1e3 * load_rig("tank").sensors.positions
    assert np.sqrt(np.mean((spread / np.array(told["positions_mm"]["std"])) ** 2)) < 1.8


def test_a_track_that_is_longer_than_its_recordings_is_refused(stage, tmp_path, monkeypatch, capsys):
    track = read_known_track(stage[0] / "kept" / "track.csv")
    write_known_track(tmp_path / "t.csv", [*track.poses, track.poses[0]], [str(track.files[0].resolve())] * (POSES + 1))
    code, _, error = run(monkeypatch, capsys, tmp_path / "t.csv")
    assert code == 2
    assert f"{POSES + 1} rows, but" in error
    assert f"holds {POSES} shots" in error


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--samples", "x.npz"), "--samples needs a TRACK"),
        (("t.csv", "--keep", "x"), "--keep is for the rig's own stage"),
        (("none.csv",), "none.csv: no such file"),
    ],
)
def test_options_that_exclude_each_other_are_refused(monkeypatch, capsys, options, says):
    code, _, error = run(monkeypatch, capsys, *options)
    assert code == 2
    assert says in error


def test_a_world_without_a_stage_asks_for_recordings(monkeypatch, capsys):
    monkeypatch.delattr("sim.tank.world.TankWorld.stage")
    code, _, error = run(monkeypatch, capsys)
    assert code == 2
    assert "World 'tank' of rig 'tank' has no stage of its own; give a TRACK" in error


def test_directions_and_quaternions_say_the_same(tmp_path):
    track = plan_track(np.array([-0.02, -0.02, 0.05]), np.array([0.02, 0.02, 0.08]), 5)
    write_known_track(tmp_path / "a.csv", track, ["a.npz"] * 5)
    rows = [",".join(map(repr, [*(1e3 * p.position).tolist(), *p.orientation.tolist()])) for p in track]
    (tmp_path / "b.csv").write_text("\n".join(["x_mm,y_mm,z_mm,qw,qx,qy,qz", *rows]))
    for a, b in zip(read_known_track(tmp_path / "a.csv").poses, read_known_track(tmp_path / "b.csv").poses):
        assert a.position == pytest.approx(b.position)
        assert abs(a.orientation @ b.orientation) == pytest.approx(1.0)
