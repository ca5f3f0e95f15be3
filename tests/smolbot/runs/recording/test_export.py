"""Exports: what other programs read is the record, bit for bit; a window goes through the localizer's own door."""

from __future__ import annotations

import csv
import json

import h5py
import numpy as np
import pytest
from scipy.io import loadmat

from smolbot.config.samples import make_recordings, read_samples
from smolbot.errors import InputError
from smolbot.localization.localizer import Localizer
from smolbot.runs.recording import exporting
from smolbot.runs.recording.exporting import export_run
from smolbot.runs.recording.reader import read_run
from smolbot.runs.recording.sample_export import export_samples
from smolbot.runs.recording.tables import make_samples_table, make_tables

POSES = {
    "poses_raw": lambda m: m.cycle.pose,
    "poses_tracked": lambda m: m.cycle.tracked,
    "poses_true": lambda m: m.truth,
}


@pytest.fixture(scope="module")
def run(chunked):
    return read_run(chunked)


def bits(array):
    return np.ascontiguousarray(array, float).tobytes()


def test_hdf5_holds_poses_currents_and_samples_bit_for_bit(run, recorded, tmp_path):
    export_run(run, "h5", tmp_path / "run.h5")
    flown = recorded[0]
    with h5py.File(tmp_path / "run.h5") as file:
        for name, get in POSES.items():
            table, poses = file[name], [get(m) for m in run.moments]
            assert list(table["cycle"]) == run.number_of_cycle
            for column, of in (
                ("position_m", "position"),
                ("orientation", "orientation"),
                ("covariance", "covariance"),
            ):
                assert bits(table[column][()]) == bits([getattr(p, of) for p in poses]), (name, column)
            assert bits(table["time_s"][()]) == bits([p.time for p in poses])
            assert table["position_m"].attrs["unit"] == "m"
        played = [(s, c) for s, c in zip(file["windows/kind"].asstr(), file["windows/currents_a"][()])]
        currents = [
            w.currents for p in run.played for w in p.shot.windows if hasattr(w, "currents") and len(w.currents) > 2
        ]
        assert bits([c for kind, c in played if kind == "actuate"]) == bits(currents)
        heard = list(run.recordings())
        for (_, recording), first, n in zip(heard, file["recordings/first"], file["recordings/samples"], strict=True):
            assert bits(file["field_t"][first : first + n].T) == bits(recording.field)
        assert file["field_t"].shape[1] == len(run.converter.gains)
        assert file.attrs["status"] == flown.status
        assert file.attrs["duration_s"] == flown.duration
        assert json.loads(file["provenance_json"].asstr()[()]) == run.provenance
        assert [json.loads(d) for d in file["events/detail_json"].asstr()] == [e.detail for e in run.events]
        assert {n: bytes(c[()]) for n, c in file["files"].items()} == dict(run.begin.files)


def test_matlab_holds_the_same_tables(run, tmp_path):
    export_run(run, "mat", tmp_path / "run.mat")
    held = loadmat(tmp_path / "run.mat", simplify_cells=True)
    for name, table in make_tables(run).items():
        for column, values in table.columns.items():
            read = held[name][column]
            if isinstance(values, list):
                assert [str(v) if np.size(v) else "" for v in np.atleast_1d(read)] == values, (name, column)
            else:
                assert np.asarray(read, values.dtype).tobytes() == values.tobytes(), (name, column)
    assert bits(held["field_t"]) == bits(make_samples_table(run)[1])
    assert held["facts"]["status"] == "completed"


def test_a_run_too_large_for_older_matlab_files_is_written_as_hdf5_that_matlab_reads(run, tmp_path, monkeypatch):
    monkeypatch.setattr(exporting, "LARGEST_MAT", 1000)
    export_run(run, "mat", tmp_path / "run.mat")
    assert (tmp_path / "run.mat").read_bytes().startswith(b"MATLAB 7.3 MAT-file")
    with h5py.File(tmp_path / "run.mat") as file:
        assert bits(file["field_t"][()].T) == bits(make_samples_table(run)[1])
        assert file["field_t"].attrs["MATLAB_class"] == b"double"
        modes = [file[ref][()].tobytes().decode("utf-16-le") for ref in file["cycles/mode"][0]]
        assert modes == [m.cycle.shot.mode for m in run.moments]
        assert file["poses_raw/trusted"].attrs["MATLAB_class"] == b"logical"
        assert list(file["way_true/position_m"][()]) == [0, 3]
        assert file["way_true/position_m"].attrs["MATLAB_empty"] == 1


def test_csv_tables_read_back_to_the_same_numbers(run, tmp_path):
    export_run(run, "csv", tmp_path / "run")
    for name, get in POSES.items():
        with (tmp_path / "run" / f"{name}.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        poses = [get(m) for m in run.moments]
        assert bits([[float(r[f"position_{a}_m"]) for a in "xyz"] for r in rows]) == bits([p.position for p in poses])
        assert bits([[float(r[f"orientation_{a}"]) for a in "wxyz"] for r in rows]) == bits(
            [p.orientation for p in poses]
        )
        found = [[float(r[f"covariance_{i}{j}"]) for i in range(6) for j in range(6)] for r in rows]
        assert bits(found) == bits([p.covariance for p in poses])
    with (tmp_path / "run" / "facts.csv").open(newline="") as file:
        said = dict(csv.reader(file))
    assert float(said["duration_s"]) == run.run().duration


@pytest.mark.parametrize("kind", ["h5", "mat", "csv"])
def test_an_exported_window_is_located_where_the_recording_is(run, tmp_path, kind):
    mission = run.mission()
    played, recording = next((p, r) for p, r in run.recordings() if p.number == run.shot_of_cycle[-1])
    path = tmp_path / f"window.{kind}"
    export_samples(run, kind, path, [played.number])
    (again,) = make_recordings(read_samples(path), mission.rig).recordings
    assert np.allclose(again.field, recording.field, rtol=4e-16, atol=0.0)
    assert (again.sample_rate, again.clock) == (recording.sample_rate, recording.clock)
    assert again.time_since_drive == pytest.approx(recording.time_since_drive, rel=1e-15)
    localizer = Localizer(mission.rig.sensors, mission.robot.device, estimator="paper")
    a, b = localizer.locate(again), localizer.locate(recording)
    assert np.abs(a.position - b.position).max() < 1e-9


def test_the_commands_lead_from_a_run_to_a_pose(run, recorded, tmp_path, smolbot):
    shots = f"{run.shot_of_cycle[-3]}-{run.shot_of_cycle[-1]}"
    code, _, _ = smolbot("export", run.path, "--format", "h5", "--shots", shots, "--out", tmp_path / "s.h5")
    assert code == 0
    code, out, _ = smolbot("localize", tmp_path / "s.h5", "--rig", recorded[1] / "rig.toml", "--json")
    assert code == 0
    poses = json.loads(out)["poses"]
    for pose, moment in zip(poses, run.moments[-3:], strict=True):
        assert abs(pose["x_mm"] - 1e3 * moment.truth.position[0]) < 1.0
        assert pose["time_s"] == pytest.approx(moment.cycle.pose.time, abs=1e-9)


def test_quiet_shots_are_exported_as_quiet_samples(run, tmp_path):
    quiet = [p.number for p in run.played if p.shot.mode == "quiet" and p.shot.excite is None][:1]
    export_samples(run, "h5", tmp_path / "quiet.h5", quiet)
    assert np.isinf(read_samples(tmp_path / "quiet.h5", background_noise=True).time_since_drive).all()


def test_nothing_is_written_over_unless_told_to(run, tmp_path, smolbot):
    path = tmp_path / "run.h5"
    path.write_text("mine")
    code, _, err = smolbot("export", run.path, "--format", "h5", "--out", path)
    assert (code, err.count("\n"), path.read_text()) == (2, 1, "mine")
    assert "--force" in err
    assert smolbot("export", run.path, "--format", "h5", "--out", path, "--no-samples", "--force")[0] == 0
    with h5py.File(path) as file:
        assert "field_t" not in file
        assert len(file["cycles/cycle"]) == len(run.moments)
    own = tmp_path / "folder"
    own.mkdir()
    (own / "thesis.tex").write_text("mine")
    with pytest.raises(InputError, match="no export made"):
        export_run(run, "csv", own, force=True)
    assert (own / "thesis.tex").read_text() == "mine"


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--format", "xlsx"], "known: h5, csv, mat"),
        (["--format", "h5", "--shots", "a"], "numbers and ranges"),
        (["--format", "h5", "--shots", "99999"], "has no recording"),
        (["--format", "h5", "--shots", "0-9"], "unequal numbers of samples"),
        (["--format", "csv", "--shots", "8-9"], "holds one shot"),
        (["--format", "h5", "--out", "/proc/none/x.h5"], "cannot be written"),
    ],
)
def test_what_cannot_be_exported_is_one_clear_error(run, smolbot, options, told, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = smolbot("export", run.path, *options)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert told in err
