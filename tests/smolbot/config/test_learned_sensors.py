"""Sensors as a flight learned them: what a rig file believes of them, and the file that the next flight starts from."""

from __future__ import annotations

import datetime

import numpy as np
import pytest

from smolbot.config.document import ConfigError
from smolbot.config.rig import load_rig
from smolbot.config.sensors import SensorsFile, UncertaintySection, write_sensors
from smolbot.flight.session import LEARNED_SENSORS_FILE, run

OFF = {f"sensors.{key}": "0" for key in ("place_tolerance_mm", "gain_tolerance_percent", "axis_tolerance_deg")}


def covariance_of(n, seed):
    rng = np.random.default_rng(seed)
    deviations = np.tile([5e-3, 5e-3, 5e-3, 2e-4, 2e-4, 2e-4], n)
    mixed = rng.standard_normal((6 * n, 8))
    full = mixed @ mixed.T + 2.0 * np.eye(6 * n)
    scale = deviations / np.sqrt(np.diag(full))
    return full * np.outer(scale, scale)


def written(path, covariance):
    section = load_rig("tank").sections.sensors
    uncertainty = UncertaintySection.from_covariance(covariance, 300)
    write_sensors(
        path, SensorsFile(rig="tank", date=datetime.date(2026, 11, 25), sensors=section, uncertainty=uncertainty)
    )
    return {"sensors.calibrated": str(path)}


def test_tolerances_of_the_rig_file_are_what_is_believed():
    covariance = load_rig("tank").sensor_covariance
    one = np.sqrt(np.diag(covariance)[:6])
    assert one == pytest.approx([5e-3, np.radians(0.3), np.radians(0.3), 2e-4, 2e-4, 2e-4])
    assert np.count_nonzero(covariance - np.diag(np.diag(covariance))) == 0
    assert load_rig("tank", OFF).sensor_covariance is None


def test_what_was_learned_is_read_back_with_what_hangs_together(tmp_path):
    covariance = covariance_of(10, 1)
    read = load_rig("tank", written(tmp_path / "learned.toml", covariance)).sensor_covariance
    scale = np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    assert np.abs(read / scale - covariance / scale).max() < 1e-4
    assert np.linalg.eigvalsh(read / scale).min() > 0.0


def test_a_sensors_file_that_says_nothing_of_its_errors_is_believed_as_it_stands(tmp_path):
    settings = written(tmp_path / "learned.toml", covariance_of(10, 1))
    text = (tmp_path / "learned.toml").read_text()
    (tmp_path / "learned.toml").write_text(text.split("[uncertainty]")[0])
    assert load_rig("tank", settings).sensor_covariance is None


def test_what_a_stage_calibrated_is_left_as_it_is(tmp_path):
    settings = written(tmp_path / "stage.toml", covariance_of(10, 1))
    lines = (tmp_path / "stage.toml").read_text().splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("correlations"))
    end = next(i for i in range(at, len(lines)) if lines[i].strip() == "]" or lines[i].endswith("]]"))
    (tmp_path / "stage.toml").write_text("\n".join(lines[:at] + lines[end + 1 :]) + "\n")
    rig = load_rig("tank", settings)
    assert rig.calibrated.array is not None
    assert rig.sensor_covariance is None


def test_a_triangle_with_a_row_too_short_is_told(tmp_path):
    settings = written(tmp_path / "learned.toml", covariance_of(10, 1))
    lines = (tmp_path / "learned.toml").read_text().splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("correlations"))
    (tmp_path / "learned.toml").write_text("\n".join([*lines[: at + 3], *lines[at + 4 :]]) + "\n")
    with pytest.raises(ConfigError, match="correlations must be 60 rows"):
        load_rig("tank", settings)


def test_a_flight_leaves_what_it_learned_and_the_next_one_starts_from_it(tmp_path):
    first = run("line", seed=4, out=tmp_path / "one", report=False, force="preview")
    learned = [e for e in first.events if e.what == "array learned"]
    assert learned
    path = tmp_path / "one" / LEARNED_SENSORS_FILE
    nominal, next_rig = load_rig("tank"), load_rig("tank", {"sensors.calibrated": str(path)})
    moved = next_rig.sensors.positions - nominal.sensors.positions
    assert 2e-6 < np.abs(moved).max() < 6e-4
    assert next_rig.sensors.axes == pytest.approx(np.array(learned[-1].detail["axes"]), abs=2e-3)
    before, after = nominal.sensor_covariance, next_rig.sensor_covariance
    assert np.linalg.slogdet(after)[1] < np.linalg.slogdet(before)[1] - 5.0
    second = run("line", seed=4, rig__sensors__calibrated=str(path), force="preview")
    assert second.summary["verdict"] == "passed"


def test_nothing_is_learned_or_left_where_no_tolerance_is_given(tmp_path):
    off = {f"rig__{k.replace('.', '__')}": v for k, v in OFF.items()}
    flown = run("line", seed=4, out=tmp_path / "one", report=False, force="preview", **off)
    assert not [e for e in flown.events if e.what == "array learned"]
    assert not (tmp_path / "one" / LEARNED_SENSORS_FILE).exists()
