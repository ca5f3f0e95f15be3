"""The swinging magnet against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from sim.tank.magnetics.cantilever import STATE_LENGTH, advance_cantilever
from sim.tank.magnetics.coil_fields import pack_coils
from sim.tank.magnetics.device_packing import MAGNET_MASS, pack_device
from sim.tank.magnetics.tank_coils import find_magnet_volume
from sim.tank.tank import NO_SAMPLES

MOMENT, L0, THETA_MAX, FREQUENCY = 0.89e-3, 1.5e-3, np.radians(17.8), 103.5
LEVEL = ((0.0, 0.0, 0.0595), (1.0, 0.0, 0.0, 0.0))


class Bench:
    """A cantilever held still in a uniform field (`earth`), or in one coil's."""

    def __init__(self, damping, model, *, moment=(0.0, 0.0, 1.0), earth=(0.0, 0.0, 0.0), coil=None, restitution=0.2):
        self.device = pack_device(
            MOMENT, np.array(moment), L0, THETA_MAX, FREQUENCY, damping, model, restitution, (0, 0, 0.5e-3), MAGNET_MASS
        )
        self.earth = np.array(earth)
        self.rows, self.table, self.circuits = np.zeros((0, 22)), np.zeros(1), np.zeros((0, 4))
        if coil is not None:
            self.rows, self.table = coil.rows, coil.coefficients
            self.circuits = np.zeros((len(coil.rows), 4))
        self.state = np.zeros(STATE_LENGTH)

    def run(self, steps, step=1e-3, substeps=50):
        """Deflection (and currents) every 20 us, shape (steps * substeps, 1 + n_coils)."""
        trace = np.empty((steps * substeps, 1 + len(self.circuits)))
        for k in range(steps):
            advance_cantilever(
                *LEVEL, self.device, self.earth, self.rows, self.table, self.circuits, self.state,
                np.empty((1, 7)), 0, trace, k * substeps, step, substeps, NO_SAMPLES, 0,
            )  # fmt: skip
        return trace


def peaks(theta):
    """Times in s and heights of the positive maxima, by parabolas through three samples."""
    i = np.flatnonzero((theta[1:-1] > theta[:-2]) & (theta[1:-1] >= theta[2:])) + 1
    a, b, c = theta[i - 1], theta[i], theta[i + 1]
    shift = 0.5 * (a - c) / (a - 2 * b + c)
    return (i + 1 + shift) * 2e-5, b - 0.25 * (a - c) * shift


@pytest.mark.parametrize("model", ["linear", "exponential"])
def test_free_oscillation_has_the_frequency_and_the_envelope_of_its_damping_model(model):
    damping = 1.1 if model == "linear" else 31.7
    bench = Bench(damping, model)
    bench.state[0] = 0.95 * THETA_MAX
    times, heights = peaks(bench.run(100)[:, 0])
    assert 1 / np.diff(times) == pytest.approx(FREQUENCY, rel=2e-4)
    envelope = (
        0.95 * THETA_MAX * np.exp(-damping * times) if model == "exponential" else (0.95 - damping * times) * THETA_MAX
    )
    scale = heights[0] / envelope[0]
    assert scale == pytest.approx(1.0, abs=5e-3)
    assert heights == pytest.approx(scale * envelope, rel=2e-3)


def test_cantilever_in_steel_is_about_six_micronewton_metre_per_radian():
    device = Bench(1.1, "linear").device
    assert device[9] * device[5] == pytest.approx(5.6e-6, rel=0.02)


@pytest.mark.parametrize("damping", [0.0, 31.7])
def test_drive_at_resonance_grows_as_the_torque_about_the_axis_of_oscillation(rig, damping):
    """A' = Q / (2 I omega) - eta A with Q = m |B . (y x m)|, to which the pull of the gradient on the lever l0 adds."""
    coils = rig.flat_coils()[:1]
    field = pack_coils(coils, np.zeros((1, 3)), np.zeros((1, 3)), np.ones(1), *find_magnet_volume(rig))
    bench = Bench(damping, "exponential", coil=field)
    current, omega = 0.3, 2 * np.pi * FREQUENCY
    bench.circuits[0, 2], bench.state[3] = current, omega
    theta = bench.run(60)[:, 0]
    b = current * coils[0].field(np.array([[0.0, 0.0, 0.0605], [0.0, 0.0, 0.0604], [0.0, 0.0, 0.0606]]))[:, 0]
    drive = b[0] + L0 * (b[2] - b[1]) / 2e-4
    assert drive == pytest.approx(b[0], rel=0.1)
    rate = MOMENT * abs(drive) / (2 * bench.device[9] * omega)
    times, heights = peaks(theta)
    expected = rate * times if damping == 0 else rate / damping * (1 - np.exp(-damping * times))
    assert heights[-1] == pytest.approx(expected[-1], rel=0.01)
    assert 50 < rate / abs(drive) * 1e-3 < 53


def test_field_across_the_drive_direction_leaves_the_cantilever_at_rest():
    bench = Bench(1.1, "linear", earth=(0.0, 3e-3, 2e-3))
    assert np.abs(bench.run(50)[:, 0]).max() < 1e-9


def test_static_field_deflects_by_torque_over_stiffness():
    bench = Bench(300.0, "exponential", earth=(1e-3, 0.0, 0.0))
    theta = bench.run(200)[-1, 0]
    assert theta == pytest.approx(MOMENT * 1e-3 * np.cos(theta) / (bench.device[9] * bench.device[5]), rel=1e-3)


def test_deflection_never_exceeds_the_stops():
    bench = Bench(1.1, "linear", earth=(5e-3, 0.0, 0.0))
    theta = bench.run(100)[:, 0]
    assert theta.max() == pytest.approx(THETA_MAX)
    assert theta[-1] == pytest.approx(THETA_MAX, rel=1e-3)  # pushed against the stop, it comes to rest there


def test_coil_current_rises_and_decays_with_its_time_constant(rig):
    coils = rig.round_coils()[:1]
    bench = Bench(
        1.1, "linear", coil=pack_coils(coils, np.zeros((1, 3)), np.zeros((1, 3)), np.ones(1), *find_magnet_volume(rig))
    )
    tau = 3e-3
    bench.circuits[0, 1], bench.circuits[0, 3] = 8.0, tau
    time = 2e-5 * np.arange(1, 1501)
    assert bench.run(30)[:, 1] == pytest.approx(8.0 * (1 - np.exp(-time / tau)), rel=1e-9)
    last, bench.circuits[0, 1] = bench.circuits[0, 0], 0.0
    assert bench.run(60)[:1500, 1] == pytest.approx(last * np.exp(-time / tau), rel=1e-9)
    assert 0 < bench.circuits[0, 0] == pytest.approx(last * np.exp(-0.06 / tau), rel=1e-6)


def test_excitation_starts_at_zero_and_reaches_the_commanded_peak(rig):
    coils = rig.flat_coils()[:1]
    bench = Bench(
        1.1, "linear", coil=pack_coils(coils, np.zeros((1, 3)), np.zeros((1, 3)), np.ones(1), *find_magnet_volume(rig))
    )
    bench.circuits[0, 2:], bench.state[3] = (2.0, 1e-3), 2 * np.pi * FREQUENCY
    current = bench.run(48)[:, 1]
    assert abs(current[0]) < 0.01
    assert current[-1000:].max() == pytest.approx(2.0, rel=1e-3)
