"""Samples that are not what they should be: one error that names them, or the channel left out and said so."""

from __future__ import annotations

import json
import re
import sys

import numpy as np
import pytest

from sim.tank.static_bench import StaticBench
from smolbot.bench.calibration.device import CalibrationPlan
from smolbot.config.rig import load_rig
from smolbot.config.robot import load_robot
from smolbot.config.sample_checks import find_invalid_channels
from smolbot.core.rotations import quaternion_from_axes
from smolbot.core.sensing import Recording
from smolbot.errors import InputError
from smolbot.localization.localizer import Localizer
from smolbot.localization.noise.model import NoiseModel
from smolbot.ui.cli.app import main

RATE = 50_000.0
PLACES = ((1.0, 0.0, 60.0), (2.0, 0.0, 60.0), (3.0, 0.0, 60.0))
TURN = quaternion_from_axes(np.array([0.8, 0.6, 0.0]), np.array([0.0, 0.0, 1.0]), "zy")


@pytest.fixture(scope="module")
def heard():
    """Volts of three shots (3, 10, n), and of three quiet seconds (3, 10, n), from the simulated bench."""
    bench = StaticBench(load_rig("tank"), load_robot("gradient").device, 1)
    shots = [bench.record(1e-3 * np.array(place), TURN, 6).field for place in PLACES]
    quiet = [bench.record_background(1.0)[0].field for _ in range(3)]
    return 1e6 * np.stack(shots), 1e6 * np.stack(quiet)


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """``run(name, *options, **files)``: writes .npz files, then exit code, output and errors of a command."""

    def call(command, *options, **files):
        for name, values in files.items():
            values = {"sample_rate_hz": RATE, "time_since_drive_ms": 20.0, **values}
            np.savez(tmp_path / f"{name}.npz", **{k: v for k, v in values.items() if v is not None})
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", ["smolbot", command, *map(str, options)])
        with pytest.raises(SystemExit) as left:
            main()
        printed = capsys.readouterr()
        return left.value.code, printed.out, printed.err

    return call


def hurt(volts, where, value):
    copy = volts.copy()
    copy[where] = value
    return copy


BAD = {
    "tesla": (
        lambda v: {"volts": 1e-6 * v},
        r"must be in V, .* channel \d moves most, by .*e-08 V, .* Are they in T",
    ),
    "millivolt": (
        lambda v: {"volts": 1e3 * v},
        r"at most \d of 10 channels are not saturated; channel \d reaches .* in mV, nT",
    ),
    "huge constant": (
        lambda v: {"volts": v + 1e6},
        "at most 0 of 10 channels are not saturated; .* the constant field not nulled",
    ),
    "counts": (lambda v: {"volts": (3277 * v).astype(np.int16)}, "at most 0 of 10 channels are not saturated"),
    "all dead": (lambda v: {"volts": 0 * v + 0.2}, r"every channel is dead: constant, channel 0 at 0\.2 V"),
    "flags": (lambda v: {"volts": v > 0}, "volts must be real numbers: they are of type bool"),
    "kilohertz": (
        lambda v: {"volts": v, "sample_rate_hz": 50.0},
        "50 samples per second; .* at least 1035",
    ),
    "one a second": (lambda v: {"volts": v, "sample_rate_hz": 1.0}, "1 samples per second"),
    "negative rate": (lambda v: {"volts": v, "sample_rate_hz": -RATE}, "sample_rate_hz must be positive; got -50000"),
    "no rate": (lambda v: {"volts": v, "sample_rate_hz": np.nan}, r"must be one finite number; got \[nan\]"),
    "long ago": (lambda v: {"volts": v, "time_since_drive_ms": 2e4}, "The oscillation has decayed 20000 ms after"),
    "infinite": (lambda v: {"volts": hurt(v, (1, 4, 7), np.inf)}, "channel 4, sample 7 of shot 1 is inf"),
    "shots last": (lambda v: {"volts": v.transpose(1, 2, 0)}, "looks transposed"),
    "shots between": (lambda v: {"volts": v.transpose(1, 0, 2)}, "3 channels; .* looks transposed"),
    "half a half-period": (lambda v: {"volts": v[:, :, :120]}, r"lasts 2\.40 ms .* takes 4\.83 ms"),
    "one sample": (lambda v: {"volts": v[:, :, :1]}, "1 samples at 50000 Hz"),
}


@pytest.mark.parametrize("estimator", ["whitened", "paper"])
@pytest.mark.parametrize("case", BAD)
def test_bad_samples_get_one_error_that_names_the_file(run, heard, case, estimator):
    spoil, says = BAD[case]
    code, out, error = run("localize", "my.npz", "--rig", "tank", "--estimator", estimator, my=spoil(heard[0]))
    assert (code, out, error.count("\n")) == (2, "", 1)
    assert error.startswith("my.npz: ")
    assert re.search(says, error), error


QUIET = {
    "nan": (lambda q: {"volts": hurt(q, (0, 3, 100), np.nan)}, "channel 3, sample 100 of shot 0 is nan"),
    "all dead": (lambda q: {"volts": 0 * q}, "every channel is dead"),
    "tesla": (lambda q: {"volts": 1e-6 * q}, "Are they in T"),
    "most dead": (
        lambda q: {"volts": hurt(q, (slice(None), slice(0, 8)), 0.1)},
        r"only 2 channels are of use, at least 6 are needed; left out: dead \(constant\) channels 0, 1, 2",
    ),
    "no shot whole": (
        lambda q: {"volts": hurt(hurt(hurt(q, (0, 1), 0.1), (1, 2), 10.0), (2, 5), 0.1)},
        r"no shot is quiet in all .* shot 0: left out: dead \(constant\) channel 1; shot 1: .* saturated channel 2",
    ),
    "channels": (lambda q: {"volts": q[:, :9]}, "9 channels; rig 'tank' has 10"),
    "short": (lambda q: {"volts": q[:, :, :5000]}, r"lasts 0\.100 s; at least 0\.3 s"),
    "slow": (lambda q: {"volts": q[:, :, ::50], "sample_rate_hz": 1e3}, "1000 samples per second; .* takes 5000"),
}


@pytest.mark.parametrize("case", QUIET)
def test_bad_quiet_samples_get_one_error_that_names_their_file(run, heard, case):
    spoil, says = QUIET[case]
    files = {"my": {"volts": heard[0]}, "still": {**spoil(heard[1])}}
    code, out, error = run("localize", "my.npz", "--rig", "tank", "--quiet", "still.npz", **files)
    assert (code, out, error.count("\n")) == (2, "", 1)
    assert error.startswith("still.npz: ")
    assert re.search(says, error), error


@pytest.mark.parametrize("value", [0.25, 10.0], ids=["dead", "saturated"])
def test_a_channel_of_no_use_in_the_quiet_samples_is_left_out_and_named(run, heard, value):
    files = {"my": {"volts": heard[0]}, "still": {"volts": hurt(heard[1], (slice(None), 3), value)}}
    code, out, _ = run("localize", "my.npz", "--rig", "tank", "--quiet", "still.npz", "--json", **files)
    told = json.loads(out)
    assert (code, told["trusted"]) == (0, 3)
    assert "channel 3" in told["quiet"]
    assert all(row["note"] == "left out: channel 3, of no use in the quiet samples" for row in told["poses"])
    for row, place in zip(told["poses"], PLACES):
        assert [row["x_mm"], row["y_mm"], row["z_mm"]] == pytest.approx(place, abs=1.0)


def test_a_quiet_shot_with_a_dead_channel_does_not_spoil_the_others(run, heard):
    shots, quiet = heard
    whole = run("localize", "my.npz", "--rig", "tank", "--quiet", "still.npz", "--json", my={"volts": shots},
                still={"volts": quiet[[0, 2]]})  # fmt: skip
    hurt_one = run("localize", "my.npz", "--rig", "tank", "--quiet", "still.npz", "--json", my={"volts": shots},
                   still={"volts": hurt(quiet, (1, 3), 0.25)})  # fmt: skip
    first, second = json.loads(whole[1]), json.loads(hurt_one[1])
    assert "1 of 3 shots left out: shot 1, dead (constant) channel 3" in second["quiet"]
    assert second["poses"] == first["poses"]


def test_the_noise_of_a_dead_channel_is_that_of_the_others():
    rng = np.random.default_rng(1)
    field = 1e-10 * rng.standard_normal((4, 50_000))
    field[2] = 3e-9
    model = NoiseModel.learn([Recording(field, RATE, np.inf)])
    power = np.real(np.einsum("fjj->fj", model.spectrum))
    assert power[:, 2] == pytest.approx(power[:, [0, 1, 3]].mean(axis=1))
    assert np.all(model.spectrum[:, 2, [0, 1, 3]] == 0.0)
    np.linalg.cholesky(model.covariance(8, 5e-4))
    with pytest.raises(InputError, match="Every channel of the background recordings is saturated or constant"):
        NoiseModel.learn([Recording(np.ones((4, 50_000)), RATE, np.inf)])


STUCK = {
    "saturated for 1 ms": (lambda v: hurt(v, np.s_[2, 100:150], -10.0), "saturated"),
    "stuck at the start": (lambda v: hurt(v, np.s_[2, :700], 0.3), "stuck (constant for a while)"),
    "stuck in between": (lambda v: hurt(v, np.s_[2, 600:660], 0.3), "stuck (constant for a while)"),
    "clipped below the range": (
        lambda v: hurt(v, 2, np.minimum(v[2], v[2].min() + 0.7 * np.ptp(v[2]))), "stuck (constant for a while)"
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", STUCK)
def test_a_channel_that_fails_for_part_of_the_window_is_left_out_and_named(run, heard, case):
    spoil, says = STUCK[case]
    volts = heard[0].copy()
    volts[1] = spoil(volts[1])
    code, out, _ = run("localize", "my.npz", "--rig", "tank", "--json", my={"volts": volts})
    poses = json.loads(out)["poses"]
    assert code == 0
    assert [row["note"] for row in poses] == ["", f"left out: {says} channel 2", ""]
    assert poses[1]["x_mm"] == pytest.approx(PLACES[1][0], abs=2.0)  # nine sensors, each slightly off


@pytest.mark.parametrize("bits", [12, 16, 24])
def test_sound_channels_are_not_taken_for_stuck_whatever_the_converter(bits):
    """Weak, strong and dying swings, and quiet: coarse steps make a channel stand still by itself."""
    rig = load_rig("tank", {"sensors.adc_bits": str(bits)})
    bench = StaticBench(rig, load_robot("gradient").device, 3)
    heard = [bench.record(np.array([0.0, 0.0, z]), TURN, n) for z in (0.05, 0.1, 0.2) for n in (1, 2, 20)]
    for recording in [*heard, *bench.record_background(1.0)]:
        found = find_invalid_channels(1e6 * recording.field, bench.rate, rig)
        assert not found["stuck (constant for a while)"].any()


@pytest.mark.parametrize("at_ms", [70.0, 80.0, 85.0])
def test_a_channel_that_hangs_late_in_a_dying_swing_is_stuck_although_little_of_a_swing_is_left(at_ms):
    """A millisecond's hold on the flank of what was 300 steps high: it comes off by 13 to 19 steps, not by hundreds."""
    rig = load_rig("tank")
    step = 2.0 * rig.sections.sensors.adc_range_v / 2.0**rig.sections.sensors.adc_bits
    time = np.arange(round(20 * RATE / (2.0 * 103.5))) / RATE
    phases = np.linspace(0.0, 2.0, 10)[:, None]
    volts = 0.1 + step * np.round(300.0 * np.exp(-31.7 * time) * np.sin(2.0 * np.pi * 103.5 * time + phases))
    assert not find_invalid_channels(volts, RATE, rig)["stuck (constant for a while)"].any()
    held = np.flatnonzero((time >= 1e-3 * at_ms) & (time < 1e-3 * at_ms + 1e-3))
    volts[4, held] = volts[4, held[0]]
    assert 8.0 < abs(volts[4, held[-1] + 1] - volts[4, held[0]]) / step < 24.0
    assert np.flatnonzero(find_invalid_channels(volts, RATE, rig)["stuck (constant for a while)"]).tolist() == [4]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "missing volts .*such as '# sample_rate_hz = 20'"),
        ("# sample_rate_hz = 50000\n# time_since_drive_ms = 20\n", r"missing volts \(the samples[^']*V\)\.$"),
        ("# sample_rate_hz = fast\n1,2\n", r":1: sample_rate_hz is not a number \('fast'\)"),
        ("a,b\nhello,you\n", r":2: column 0 is not a number \('hello'\)"),
        ("# sample_rate_hz = 50000\n0,1;0,2\n", r":2: has both ',' and ';'\. Write decimals with a point"),
    ],
)
def test_a_csv_of_no_use_is_refused_with_its_line(run, tmp_path, text, says):
    (tmp_path / "my.csv").write_text(text)
    code, _, error = run("localize", "my.csv", "--rig", "tank")
    assert code == 2
    assert re.search(says, error.strip()), error


@pytest.mark.parametrize("suffix", [".npz", ".mat", ".h5"])
def test_an_empty_file_is_refused(run, tmp_path, suffix):
    (tmp_path / f"my{suffix}").touch()
    code, _, error = run("localize", f"my{suffix}", "--rig", "tank")
    assert (code, error.count("\n")) == (2, 1)
    assert f"my{suffix}: cannot be read as" in error
    (tmp_path / "folder.npz").mkdir()
    code, _, error = run("localize", "folder.npz", "--rig", "tank")
    assert (code, error) == (2, "folder.npz: is a folder; name a file of samples.\n")


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--z-std-mm", "inf"), "height_std must be 0 or more, in m, and finite; got inf"),
        (("--span-hz", 60), "sweep_span must be below half the assumed frequency, 51.75 Hz; got 60"),
        (("--span-hz", "nan"), "sweep_span must be positive; got nan"),
        (("--out", "none/device.toml"), "--out none/device.toml: there is no folder none"),
        (("--out", "."), "--out .: is a folder; name a file"),
        (("--set", "rig.sensors.sample_rate_hz=100"), "100 samples per second; a device of 103.5 Hz needs"),
    ],
)
def test_calibrations_that_cannot_be_carried_out_are_refused(run, options, says):
    code, _, error = run("calibrate", "tank", "--z-mm", 60, *options)
    assert (code, error.count("\n")) == (2, 1)
    assert says in error


def test_a_plan_needs_a_finite_height_error():
    with pytest.raises(InputError, match="finite"):
        CalibrationPlan(height_std=float("nan"))


def test_a_localizer_refuses_what_it_could_only_choke_on(heard):
    rig, device = load_rig("tank"), load_robot("gradient").device
    localizer = Localizer(rig.sensors, device)
    with pytest.raises(InputError, match="50 samples per second"):
        localizer.locate(Recording(1e-6 * heard[0][0], 50.0, 0.02))
    with pytest.raises(InputError, match="The oscillation has decayed 20000 ms"):
        localizer.locate(Recording(1e-6 * heard[0][0], RATE, 20.0))
