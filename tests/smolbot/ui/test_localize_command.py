"""A lab's own samples: every way of writing them gives the same poses, and bad ones are named."""

from __future__ import annotations

import csv
import datetime
import json
import sys

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from smolbot.config.device import DeviceConfig, write_device
from smolbot.config.rig import load_rig
from smolbot.config.robot import load_robot
from smolbot.config.samples import make_recordings, read_samples
from smolbot.errors import InputError, MissingFileError
from smolbot.ui.cli.app import main

RATE = 50_000.0


@pytest.fixture(scope="module")
def rig():
    return load_rig("tank")


@pytest.fixture
def samples(array, along_device, pose_at, hear):
    """Three shots of a device that moves on by 1 mm each, six half-periods, in V."""
    places = [(x, 1.0, 65.0) for x in (2.0, 3.0, 4.0)]
    heard = [hear(array, along_device, pose_at(place, 30.0), 6) for place in places]
    volts = np.stack([r.field for r in heard]) * 1e6 + 0.01  # 1 V/µT, and a constant
    noise = 1e-4 * np.random.default_rng(1).standard_normal(volts.shape)
    clock = np.array([0.0, 0.2, 0.4])
    return {"volts": volts + noise, "sample_rate_hz": RATE, "time_since_drive_ms": 20.0, "clock_s": clock}


def write(path, values):
    if path.suffix == ".npz":
        np.savez(path, **values)
    elif path.suffix == ".mat":
        savemat(path, values)
    elif path.suffix == ".h5":
        with h5py.File(path, "w") as file:
            file["volts"] = values["volts"]
            for key in set(values) - {"volts"}:
                file.attrs[key] = values[key]
    else:
        header = [f"# {key} = {values[key]}" for key in ("sample_rate_hz", "time_since_drive_ms") if key in values]
        names = ",".join(f"ch{i}" for i in range(values["volts"].shape[-2]))
        rows = [",".join(map(repr, row.tolist())) for row in values["volts"][0].T]
        path.write_text("\n".join([*header, names, *rows]) + "\n")
    return path


def run(monkeypatch, capsys, *arguments):
    """Exit code and what was printed on standard output and standard error."""
    monkeypatch.setattr(sys, "argv", ["smolbot", "localize", *map(str, arguments)])
    with pytest.raises(SystemExit) as left:
        main()
    printed = capsys.readouterr()
    return left.value.code, printed.out, printed.err


@pytest.mark.parametrize("suffix", [".npz", ".mat", ".h5", ".csv"])
def test_every_format_holds_the_same_samples(tmp_path, samples, rig, suffix):
    found = read_samples(write(tmp_path / f"shots{suffix}", samples))
    shots = 1 if suffix == ".csv" else 3
    assert found.volts == pytest.approx(samples["volts"][:shots], rel=1e-12)
    assert found.sample_rate == RATE
    assert found.time_since_drive == pytest.approx(np.full(shots, 0.02))
    if suffix != ".csv":
        assert found.clock == pytest.approx(samples["clock_s"])
    recordings = make_recordings(found, rig).recordings
    assert recordings[0].field == pytest.approx(1e-6 * samples["volts"][0])


def test_matlab_7_3_files_have_their_axes_in_reverse(tmp_path, samples):
    path = tmp_path / "shots.mat"
    with h5py.File(path, "w") as file:
        for key, value in samples.items():
            file[key] = np.asarray(value).T if np.ndim(value) > 1 else np.reshape(value, (-1, 1))
    assert read_samples(path).volts == pytest.approx(samples["volts"])


@pytest.mark.parametrize("estimator", ["whitened", "paper"])
def test_poses_are_where_the_device_was(tmp_path, samples, monkeypatch, capsys, estimator):
    path, out = write(tmp_path / "shots.npz", samples), tmp_path / "poses.csv"
    code, printed, _ = run(monkeypatch, capsys, path, "--rig", "tank", "--estimator", estimator, "--out", out, "--json")
    assert code == 0
    told = json.loads(printed)
    assert told["trusted"] == 3
    assert [p["x_mm"] for p in told["poses"]] == pytest.approx([2.0, 3.0, 4.0], abs=0.6)
    with out.open() as file:
        rows = list(csv.DictReader(file))
    assert [float(r["x_mm"]) for r in rows] == pytest.approx([p["x_mm"] for p in told["poses"]])
    assert [float(r["time_s"]) for r in rows] == pytest.approx(samples["clock_s"] + 0.5 * 1449 / RATE)
    assert all(float(r["sigma_z_mm"]) > 0 and r["trusted"] == "1" for r in rows)


def test_superfast_gives_a_pose_from_every_segment(tmp_path, samples, monkeypatch, capsys):
    path, out = write(tmp_path / "shots.npz", samples), tmp_path / "poses.json"
    code, _, _ = run(monkeypatch, capsys, path, "--rig", "tank", "--superfast", 2, "--out", out)
    rows = json.loads(out.read_text())["poses"]
    assert code == 0
    assert [(r["shot"], r["segment"]) for r in rows] == [(i, j) for i in range(3) for j in range(3)]


def test_channels_that_saturate_or_go_silent_are_named_and_left_out(tmp_path, samples, rig, monkeypatch, capsys):
    samples["volts"][1, 3] = 10.0
    samples["volts"][1, 0] = 0.25
    shots = make_recordings(read_samples(write(tmp_path / "shots.npz", samples)), rig)
    assert np.flatnonzero(shots.recordings[1].saturated).tolist() == [0, 3]
    code, printed, _ = run(monkeypatch, capsys, tmp_path / "shots.npz", "--rig", "tank", "--json")
    rows = json.loads(printed)["poses"]
    assert code == 0
    assert "saturated channel 3" in rows[1]["note"]
    assert "dead (constant) channel 0" in rows[1]["note"]
    assert rows[0]["note"] == rows[2]["note"] == ""


def test_a_shot_that_cannot_be_located_keeps_its_row(tmp_path, samples, monkeypatch, capsys):
    samples["volts"][1, :8] = 10.0
    code, printed, _ = run(monkeypatch, capsys, write(tmp_path / "shots.npz", samples), "--rig", "tank", "--json")
    rows = json.loads(printed)["poses"]
    assert [row["shot"] for row in rows] == [0, 1, 2]
    assert [row["trusted"] for row in rows] == [1, 0, 1]
    assert code == 0
    assert rows[1]["note"]


def test_noise_alone_is_no_pose(tmp_path, samples, monkeypatch, capsys):
    samples["volts"] = 1e-4 * np.random.default_rng(2).standard_normal(samples["volts"].shape)
    code, printed, _ = run(monkeypatch, capsys, write(tmp_path / "shots.npz", samples), "--rig", "tank", "--json")
    assert code == 1
    assert not any(row["trusted"] for row in json.loads(printed)["poses"])


def changed(values, **changes):
    return {key: value for key, value in {**values, **changes}.items() if value is not None}


def hurt(volts, where, value):
    copy = volts.copy()
    copy[where] = value
    return copy


BAD = {
    "channels": (lambda v: changed(v, volts=v["volts"][:, :9]), r"9 channels; rig 'tank' has 10"),
    "transposed": (lambda v: changed(v, volts=v["volts"][0].T, clock_s=None), "looks transposed"),
    "nan": (lambda v: changed(v, volts=hurt(v["volts"], (2, 4, 17), np.nan)), "channel 4, sample 17 of shot 2 is nan"),
    "no rate": (lambda v: changed(v, sample_rate_hz=None), "missing sample_rate_hz"),
    "rate": (lambda v: changed(v, sample_rate_hz=0.0), "sample_rate_hz must be positive; got 0"),
    "no time": (lambda v: changed(v, time_since_drive_ms=None), "missing time_since_drive_ms"),
    "early": (lambda v: changed(v, time_since_drive_ms=-3.0), "must not be negative; got -3"),
    "unknown": (lambda v: changed(v, sample_rate=5e4), "unknown key sample_rate; .*Did you mean sample_rate_hz"),
    "clocks": (lambda v: changed(v, clock_s=np.zeros(2)), "clock_s must be one finite number, or one for each of 3"),
    "shape": (lambda v: changed(v, volts=v["volts"][0, 0], clock_s=None), r"volts must have shape \(n_channels, n\)"),
    "text": (lambda v: changed(v, volts=np.array([["a", "b"]])), "volts must be real numbers"),
    "short": (lambda v: changed(v, volts=v["volts"][:, :, :200]), r"lasts 4\.00 ms .* 1 half-period .* takes 4\.83 ms"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_samples_are_refused_with_what_is_needed(tmp_path, samples, monkeypatch, capsys, case):
    spoil, says = BAD[case]
    path = write(tmp_path / "shots.npz", spoil(samples))
    code, _, error = run(monkeypatch, capsys, path, "--rig", "tank")
    assert code == 2
    with pytest.raises(InputError, match=says):
        raise InputError(error)


def test_bad_cells_of_a_csv_have_their_line(tmp_path, samples):
    path = write(tmp_path / "shots.csv", samples)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:5], lines[5].replace(",", ",x", 1), *lines[6:]]))
    with pytest.raises(InputError, match=r"shots\.csv:6: column 1 is not a number"):
        read_samples(path)
    path.write_text("\n".join([*lines[:5], "1,2,3", *lines[6:]]))
    with pytest.raises(InputError, match=r"shots\.csv:6: has 3 columns; the rows above have 10"):
        read_samples(path)
    path.write_text("\n".join(line for line in lines if "rate" not in line))
    with pytest.raises(InputError, match=r"missing sample_rate_hz.*Put it into a header line"):
        read_samples(path)


def test_files_that_are_not_what_they_claim_are_refused(tmp_path):
    for suffix in (".npz", ".mat", ".h5"):
        path = tmp_path / f"junk{suffix}"
        path.write_bytes(b"no such format, but long enough to be looked at" * 20)
        with pytest.raises(InputError, match="cannot be read as"):
            read_samples(path)
    with pytest.raises(InputError, match=r"\.npz, \.mat, \.h5, \.hdf5, \.csv; got '\.wav'"):
        read_samples(tmp_path / "x.wav")
    with pytest.raises(MissingFileError):
        read_samples(tmp_path / "none.npz")


def test_a_device_file_of_another_robot_is_refused(tmp_path, samples, monkeypatch, capsys):
    device = tmp_path / "device.toml"
    write_device(device, DeviceConfig("helix", "tank", datetime.date(2026, 11, 22), load_robot("gradient").device))
    path = write(tmp_path / "shots.npz", samples)
    code, _, error = run(monkeypatch, capsys, path, "--rig", "tank", "--robot", "gradient", "--device", device)
    assert code == 2
    assert "'helix'; asked for is 'gradient'" in error
    code, printed, _ = run(monkeypatch, capsys, path, "--rig", "tank", "--device", device, "--json")
    assert code == 0
    assert json.loads(printed)["robot"] == "helix"


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--half-periods", 7), "7 half-periods of 103.5 Hz take 33.82 ms"),
        (("--superfast", 9), "9 half-periods"),
        (("--half-periods", 2, "--superfast", 2), "exclude each other"),
        (("--out", "poses.xlsx"), ".csv or .json"),
        (("--estimator", "magic"), "'whitened' or 'paper'"),
    ],
)
def test_options_that_cannot_be_met_are_refused(tmp_path, samples, monkeypatch, capsys, options, says):
    path = write(tmp_path / "shots.npz", samples)
    code, _, error = run(monkeypatch, capsys, path, "--rig", "tank", *options)
    assert code == 2
    assert says in error
