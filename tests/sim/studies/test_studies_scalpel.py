"""A passing scalpel: its field, the static fit that it misleads, and the study's figures."""

from __future__ import annotations

import numpy as np
import pytest

from sim.studies import scalpel as study
from sim.studies.benches import make_reference_orientation
from sim.studies.study import Options, cut_chunks
from smolbot.config.rig import load_rig
from smolbot.localization.forward import compute_dipole_field

SENSORS = load_rig("tank").sensors
POSITION = np.array([2e-3, -3e-3, 0.083])
DIRECTION = np.array([0.6, 0.0, 0.8])


def field_of(position, direction, moment) -> np.ndarray:
    return np.einsum("ij,ij->i", compute_dipole_field(SENSORS.positions - position, moment * direction), SENSORS.axes)


def test_static_fit_finds_five_degrees_of_freedom():
    field = field_of(POSITION, DIRECTION, 3e-3)
    near = DIRECTION + np.array([0.05, 0.1, -0.05])
    position, direction = study.fit_static(SENSORS, field, 3e-3, POSITION + 2e-3, near / np.linalg.norm(near))
    np.testing.assert_allclose(position, POSITION, atol=1e-7)
    np.testing.assert_allclose(direction, DIRECTION, atol=1e-5)


def test_static_fit_follows_a_field_that_is_not_the_magnets():
    field = field_of(POSITION, DIRECTION, 0.89e-3)
    blade = compute_dipole_field(SENSORS.positions - np.array([0.04, 0.0, 0.08]), study.SCALPEL_MOMENT)
    position, _ = study.fit_static(
        SENSORS, field + np.einsum("ij,ij->i", blade, SENSORS.axes), 0.89e-3, POSITION, DIRECTION
    )
    assert np.linalg.norm(position - POSITION) > 5e-3


def test_scalpel_moves_as_described():
    """Its field at a time is that of a dipole at x = 40 mm, z = 80 mm that came down y at 30 mm/s."""
    times, places = np.array([0.0, 0.05, 0.1]), SENSORS.positions
    for repeat in (0, 7):
        field = study.make_disturbance(repeat)(times, places)
        assert field.shape == (len(places), 3, 3)
        for k, time in enumerate(times):
            track = np.array([0.040, 0.040 - 0.004 * repeat - 0.030 * time, 0.080])
            np.testing.assert_allclose(field[:, k], compute_dipole_field(places - track, np.array([0, 0, 15.97e-3])))


def test_static_method_is_built_for_it_without_a_scalpel():
    """Nulled, and without constants, it finds its magnet to a fraction of a millimetre."""
    options = Options("scalpel", seed=2)
    chunk = cut_chunks(options, study.run_chunk, [("one", {"first": 0, "repeats": 1, "mismatch": 0.0})])[0]
    bench = study._make_magnet_bench(chunk, 0.89e-3)
    assert bench.count_samples(1) == round(study.STATIC_SECONDS * bench.rate)
    errors = [
        study.compute_static_error(bench, np.array([0, 0, 0.08]), make_reference_orientation(), None) for _ in range(4)
    ]
    assert np.sqrt(np.mean(np.square(errors))) < 3e-4
    misled = study.compute_static_error(
        bench, np.array([0, 0, 0.08]), make_reference_orientation(), study.make_disturbance(5)
    )
    assert np.linalg.norm(misled) > 5e-3


def test_study_compares_smol_with_static_magnets(tmp_path):
    options = Options("scalpel", seed=4, poses=1, estimators=("paper",))
    chunks = study.make_chunks(options)
    assert len(chunks) == 1
    outcome = study.conclude(options, [chunks[0].work(chunks[0])])
    by_kind = {(c["method"], round(c["moment_ma_m2"], 2), c["scalpel"]): c for c in outcome.figures["cases"]}
    smol, static = by_kind["paper", 0.89, True], by_kind["static", 0.89, True]
    assert smol["mae_z_mm"] < 0.5 < 1.0 < static["mae_z_mm"]
    assert by_kind["static", 10.0, False]["mae_z_mm"] < by_kind["static", 0.89, False]["mae_z_mm"]
    assert smol["n"] == len(study.HEIGHTS)
    study.draw(outcome, tmp_path / "scalpel.png")
    assert (tmp_path / "scalpel.png").stat().st_size > 10_000


@pytest.mark.parametrize("repeats", [1, 5, 20])
def test_every_repeat_is_made_once(repeats):
    chunks = study.make_chunks(Options("scalpel", poses=repeats))
    made = [r for c in chunks for r in range(c["first"], c["first"] + c["repeats"])]
    assert made == list(range(repeats))
