"""What figures show: ellipses, fit residuals, noise, heat and duty, intervals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from smolbot.runs.pictures.style import compute_ellipse
from smolbot.runs.report.background_spectrum import estimate_background_spectrum, find_background_recordings
from smolbot.runs.report.coil_load import compute_coil_load
from smolbot.runs.report.interpolated_track import InterpolatedTrack
from smolbot.runs.report.intervals import (
    compute_autocorrelation_time,
    compute_mean,
    estimate_difference,
    estimate_with_interval,
)
from smolbot.runs.report.residuals import BLOCK_DURATION, apply_low_pass, compute_density, cut_background, fit_windows


def test_an_ellipse_holds_as_much_as_it_says():
    covariance = np.array([[4.0, 1.5], [1.5, 1.0]]) * 1e-8
    rng = np.random.default_rng(0)
    errors = rng.multivariate_normal(np.zeros(2), covariance, 100_000)
    ring = compute_ellipse(covariance, 3.0)
    squared = np.einsum("ni,ij,nj->n", ring, np.linalg.inv(covariance), ring)
    np.testing.assert_allclose(squared, 9.0, rtol=1e-9)
    from matplotlib.path import Path

    outside = 1.0 - Path(compute_ellipse(covariance, 3.0, 721)).contains_points(errors).mean()
    assert outside == pytest.approx(chi2.sf(9.0, 2), rel=0.15)


def test_fits_leave_as_much_as_quiet_windows_hold(flight):
    """Away from the lines, the spectrum of residuals is that of the noise: the model at the recorded pose is right."""
    windows = list(fit_windows(flight, 30))
    assert len(windows) > 20
    n = min(window.residuals.shape[1] for window in windows)
    grid, left = compute_density([window.residuals for window in windows], 1.0 / BLOCK_DURATION)
    _, quiet = compute_density(cut_background(find_background_recordings(flight), n, 0), 1.0 / BLOCK_DURATION)
    _, heard = compute_density([window.measured[window.used] for window in windows], 1.0 / BLOCK_DURATION)
    above = (grid > 350.0) & (grid < 2000.0)
    assert np.median(left[above] / quiet[above]) == pytest.approx(1.0, abs=0.12)
    near = np.argmin(abs(grid - flight.mission.robot.device.frequency))
    assert heard[near] > 4.0 * left[near]


def test_a_wrong_pose_leaves_more(flight):
    from dataclasses import replace

    windows = list(fit_windows(flight, 5))
    moved = replace(flight, record=replace(flight.record, moments=[_shifted(m, 12e-3) for m in flight.record.moments]))
    other = list(fit_windows(moved, 5))
    assert sum(np.sum(w.residuals**2) for w in other) > 1.5 * sum(np.sum(w.residuals**2) for w in windows)


def _shifted(moment, by):
    from dataclasses import replace

    pose = moment.cycle.pose
    if pose is None:
        return moment
    return replace(
        moment, cycle=replace(moment.cycle, pose=replace(pose, position=pose.position + np.array([by, 0, 0])))
    )


def test_the_low_pass_delays_a_sine_as_a_first_order_one_does():
    step, lag, frequency = 1e-4, 1.6e-4, 103.5
    time = step * np.arange(400)
    omega = 2.0 * np.pi * frequency
    said = apply_low_pass(np.sin(omega * time)[None], step, lag)[0, 100:]
    wanted = np.imag(np.exp(1j * omega * time[100:]) / (1.0 + 1j * omega * lag))
    assert np.abs(said - wanted).max() < 1e-3


def test_lines_are_those_that_were_learned_in_flight(flight):
    noise = estimate_background_spectrum(find_background_recordings(flight))
    told = next(e.detail["lines_hz"] for e in flight.record.events if e.what == "noise learned")
    np.testing.assert_allclose(noise.line_frequencies, told, atol=1e-3)
    mains = np.argmin(abs(noise.line_frequencies - 50.0))
    assert np.all(noise.lines[mains] > 100.0 * noise.floor)
    assert estimate_background_spectrum([]) is None


def test_heat_and_duty_are_those_of_the_flight(flight):
    strain = compute_coil_load(flight)
    peaks, hottest = flight.summary["duty_peak"], flight.summary["coil_temperature_peak_c"]
    assert max(peaks.values()) > 0.1
    for index, name in enumerate(strain.names):
        assert strain.duty[:, index].max() == pytest.approx(peaks[name], abs=1e-9)
        if name in hottest:
            assert strain.temperature[:, index].max() == pytest.approx(hottest[name], abs=1e-6)


def test_an_interval_holds_the_mean_of_alike_values_as_often_as_it_says():
    """Values that forget slowly: an interval that took them for independent would miss far too often."""
    rng = np.random.default_rng(5)
    held = 0
    for _ in range(60):
        values, noise = np.zeros(400), rng.standard_normal(400)
        for i in range(1, 400):
            values[i] = 0.8 * values[i - 1] + noise[i]
        found = estimate_with_interval(values[50:], compute_mean)
        held += found.low <= 0.0 <= found.high
    assert held >= 48  # of 57 expected
    assert compute_autocorrelation_time(values) > 4.0
    assert compute_autocorrelation_time(rng.standard_normal(2000)) < 1.5


def test_a_difference_is_the_difference_and_its_interval_holds_it():
    rng = np.random.default_rng(2)
    first, second = rng.standard_normal(300), 0.6 + rng.standard_normal(300)
    found = estimate_difference(second, first, compute_mean)
    assert found.value == pytest.approx(second.mean() - first.mean())
    assert 0.0 < found.low < found.value < found.high


def test_a_track_goes_through_poses_in_straight_lines(flight):
    truths = [m.truth for m in flight.trace.moments if m.truth is not None]
    track = InterpolatedTrack.from_poses(truths, np.array([1.0, 0.0, 0.0]))
    first, second = track.times[:2]
    place, heading = track.interpolate(0.5 * (first + second))
    np.testing.assert_allclose(place, 0.5 * (track.positions[0] + track.positions[1]), atol=1e-12)
    np.testing.assert_allclose(heading, 0.5 * (track.headings[0] + track.headings[1]), atol=1e-9)
    beside = np.array([[0.0, 1e-2, 0.0]])
    through = track.with_positions(np.array([0.5 * (first + second)]), beside)
    np.testing.assert_allclose(through.interpolate(0.5 * (first + second))[0], beside[0])
    assert np.isnan(InterpolatedTrack.from_poses([], np.array([1.0, 0.0, 0.0])).interpolate(0.0)[0]).all()
