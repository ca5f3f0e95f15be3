"""The noise model and the whitened estimator, held against noise made here, not by the tank."""

import numpy as np
import pytest

from smolbot.core.pose import Pose
from smolbot.core.rotations import compute_rotation_error, quaternion_from_axes
from smolbot.core.sensing import Device, Recording, SensorArray
from smolbot.errors import InputError
from smolbot.localization.forward import compute_deflection, compute_sensor_field
from smolbot.localization.localizer import Localizer
from smolbot.localization.noise.model import NoiseModel, compute_field_covariance

RATE = 20_000.0
PLACES = np.array(
    [[-45, 12], [-3, -21], [59, 40], [-25, -49], [38, -36], [-11, 10], [27, 12], [0, -14], [28, -17], [12, 21]]
)
SENSORS = SensorArray(np.column_stack([PLACES, np.zeros(10)]) * 1e-3, np.eye(3)[[2] * 6 + [0] * 2 + [1] * 2])
ACROSS = Device(0.89e-3, np.array([1.0, 0.0, 0.0]), 1.5e-3, np.radians(17.8), 103.5, 1.1, "linear")
POSITION = np.array([3e-3, -2e-3, 0.08])
ORIENTATION = quaternion_from_axes(np.array([0.3, 1.0, 0.1]), np.array([0.0, 0.0, 1.0]), "zy")
LINES = np.array([50.02, 100.04, 137.0])
WHITE = 8e-12


class Room:
    """Lines with drawn phasors, and white noise."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        size = np.array([5e-9, 0.5e-9, 0.3e-9])[:, None]
        self.phasors = size * (self.rng.normal(size=(3, 10)) + 1j * self.rng.normal(size=(3, 10)))

    def noise(self, n: int) -> np.ndarray:
        start = self.rng.uniform(0.0, 1e3)
        wave = np.exp(2j * np.pi * np.outer(LINES, start + np.arange(n) / RATE))
        white = WHITE * np.sqrt(RATE / 2.0) * self.rng.normal(size=(10, n))
        return np.real(self.phasors.T @ wave) + white + 50e-9 * self.rng.normal(size=(10, 1))

    def quiet(self, seconds: int = 10) -> list[Recording]:
        return [Recording(self.noise(int(RATE)), RATE, np.inf) for _ in range(seconds)]

    def recording(self, half_periods: int, device: Device = ACROSS, since: float = 0.02) -> Recording:
        n = round(half_periods * RATE / (2.0 * device.frequency))
        theta = compute_deflection(
            device, since + np.arange(n) / RATE, device.theta_max, self.rng.uniform(0.0, 2.0 * np.pi)
        )
        field = compute_sensor_field(SENSORS, device, POSITION, ORIENTATION, theta)
        return Recording(field + self.noise(n), RATE, since)

    def true_model(self) -> NoiseModel:
        frequencies = np.arange(0.0, 2500.1, 5.0)
        density = np.full(len(frequencies), WHITE**2)
        lines = np.einsum("lj,lk->ljk", self.phasors, self.phasors.conj())
        return NoiseModel(LINES, lines, frequencies, density[:, None, None] * np.eye(10, dtype=complex), 1.0 / 5000.0)


@pytest.fixture(scope="module")
def room() -> Room:
    return Room(3)


@pytest.fixture(scope="module")
def learned(room: Room) -> NoiseModel:
    return NoiseModel.learn(room.quiet())


def prior() -> Pose:
    return Pose(0.0, POSITION + [5e-4, 0.0, 5e-4], ORIENTATION, np.eye(6))


def test_lines_are_found_where_they_are_and_as_strong_as_they_are(room: Room, learned: NoiseModel):
    assert learned.line_frequencies == pytest.approx(LINES, abs=0.05)
    for found, phasor in zip(learned.lines, room.phasors, strict=True):
        assert found == pytest.approx(np.outer(phasor, phasor.conj()), rel=0.1, abs=0.02 * np.abs(phasor).max() ** 2)


def test_what_is_left_between_the_lines_is_the_sensors_own_noise(learned: NoiseModel):
    band = (learned.frequencies > 20.0) & (learned.frequencies < 2000.0)
    density = np.sqrt(np.real(np.einsum("fjj->fj", learned.spectrum[band])))
    assert np.median(density) == pytest.approx(WHITE, rel=0.05)
    off = learned.spectrum[band] - np.einsum("fj,jk->fjk", np.einsum("fjj->fj", learned.spectrum[band]), np.eye(10))
    assert np.mean(np.abs(off) > 0.0) < 0.02


def test_common_broadband_noise_is_kept_as_common():
    rng = np.random.default_rng(0)
    common = rng.normal(size=(20, 1, int(RATE // 2)))
    gains = np.linspace(-1.0, 1.0, 10)[:, None]
    quiet = [Recording(1e-9 * (gains * c + 0.2 * rng.normal(size=(10, c.shape[1]))), RATE, np.inf) for c in common]
    model = NoiseModel.learn(quiet)
    i = int(np.argmin(np.abs(model.frequencies - 300.0)))
    spectrum = np.real(model.spectrum[i])
    assert spectrum[0, 9] / np.sqrt(spectrum[0, 0] * spectrum[9, 9]) == pytest.approx(-1.0 / 1.04, abs=0.05)


def test_covariance_is_that_of_the_noise(room: Room):
    blocks, size = 12, 10
    model = room.true_model()
    draws = np.array([room.noise(blocks * size).reshape(10, blocks, size).mean(axis=2) for _ in range(4000)])
    draws -= draws.mean(axis=2, keepdims=True)  # the constant of each shot is not part of the model
    centre = np.kron(np.eye(10), np.eye(blocks) - 1.0 / blocks)
    expected = centre @ model.covariance(blocks, size / RATE) @ centre
    seen = np.cov(draws.reshape(len(draws), -1).T)
    assert np.abs(seen - expected).max() < 0.12 * np.abs(expected).max()


@pytest.mark.parametrize("half_periods", [2, 6])
def test_error_is_within_a_tenth_of_the_bound_and_the_covariance_honest(
    room: Room, learned: NoiseModel, half_periods: int
):
    located = Localizer(SENSORS, ACROSS, learned)
    bound = Localizer(SENSORS, ACROSS, room.true_model())
    errors, squares, least = [], [], []
    for _ in range(250):
        recording = room.recording(half_periods)
        pose = located.locate(recording, prior())
        error = np.concatenate([pose.position - POSITION, compute_rotation_error(pose.orientation, ORIENTATION)])
        errors.append(error[:3])
        squares.append(error @ np.linalg.solve(pose.covariance, error))
        least.append(np.diag(bound.locate(recording, prior()).covariance)[:3])
        assert pose.trusted
    assert np.sqrt(np.mean(np.square(errors)) / np.mean(least)) < 1.1
    assert np.mean(squares) / 6.0 == pytest.approx(1.0, abs=0.15)


def test_whitening_halves_the_papers_error_or_better(room: Room, learned: NoiseModel):
    whitened, paper = Localizer(SENSORS, ACROSS, learned), Localizer(SENSORS, ACROSS, estimator="paper")
    recordings = [room.recording(2) for _ in range(100)]
    rms = [
        np.sqrt(np.mean([np.square(x.locate(r, prior()).position - POSITION) for r in recordings]))
        for x in (whitened, paper)
    ]
    assert rms[0] < 0.5 * rms[1]


def test_a_constant_on_a_channel_changes_nothing(room: Room, learned: NoiseModel):
    recording = room.recording(2)
    located = Localizer(SENSORS, ACROSS, learned)
    before = located.locate(recording, prior())
    field = recording.field.copy()
    field[4] += 1e-6
    after = located.locate(Recording(field, RATE, recording.time_since_drive), prior())
    assert after.position == pytest.approx(before.position, abs=1e-9)
    assert after.covariance == pytest.approx(before.covariance, rel=1e-6)


def test_a_constant_or_saturated_channel_is_left_out_also_of_the_covariance(room: Room, learned: NoiseModel):
    recording = room.recording(6)
    located = Localizer(SENSORS, ACROSS, learned)
    complete = located.locate(recording, prior())
    field = recording.field.copy()
    field[2] = field[2, 0]
    silent = located.locate(Recording(field, RATE, recording.time_since_drive), prior())
    saturated = located.locate(
        Recording(field, RATE, recording.time_since_drive, saturated=np.arange(10) == 2), prior()
    )
    assert silent.position == pytest.approx(saturated.position, abs=1e-12)
    assert np.trace(silent.covariance[:3, :3]) > np.trace(complete.covariance[:3, :3])
    assert np.linalg.norm(silent.position - POSITION) < 1e-3


def test_cold_starts_find_the_device_or_are_not_trusted(room: Room, learned: NoiseModel):
    located = Localizer(SENSORS, ACROSS, learned)
    rng = np.random.default_rng(11)
    wrong = trusted = 0
    n = round(6 * RATE / (2.0 * ACROSS.frequency))
    for _ in range(20):
        position = rng.uniform([-0.04, -0.04, 0.05], [0.04, 0.04, 0.11])
        orientation = rng.normal(size=4)
        orientation /= np.linalg.norm(orientation)
        theta = compute_deflection(ACROSS, 0.02 + np.arange(n) / RATE, ACROSS.theta_max, rng.uniform(0.0, 6.28))
        field = compute_sensor_field(SENSORS, ACROSS, position, orientation, theta) + room.noise(n)
        pose = located.locate(Recording(field, RATE, 0.02))
        far = np.linalg.norm(pose.position - position) > 5e-3
        turned = np.linalg.norm(compute_rotation_error(pose.orientation, orientation)) > np.radians(20.0)
        wrong += pose.trusted and (far or turned)
        trusted += pose.trusted
    assert wrong == 0
    assert trusted >= 18


def test_noise_alone_is_no_pose(room: Room, learned: NoiseModel):
    located = Localizer(SENSORS, ACROSS, learned)
    n = round(6 * RATE / (2.0 * ACROSS.frequency))
    assert not any(located.locate(Recording(room.noise(n), RATE, 0.02)).trusted for _ in range(5))


@pytest.mark.parametrize(("off", "index"), [(0.2, 0), (-0.2, 0)])
def test_each_fit_tells_how_far_the_resonance_is_off(room: Room, learned: NoiseModel, off: float, index: int):
    wrong = Device(0.89e-3, ACROSS.moment_in_body, 1.5e-3, ACROSS.theta_max, 103.5 - off, 1.1, "linear")
    located = Localizer(SENSORS, wrong, learned)
    steps, spread = [], []
    for _ in range(40):
        step, covariance = located.locate_swing(room.recording(6), prior())[1].estimate_resonance_error()
        steps.append(step[index])
        spread.append(covariance[index, index])
    error = np.sqrt(np.mean(spread) / len(steps))
    assert np.mean(steps) == pytest.approx(off, abs=4.0 * error + 0.01)


def test_a_model_that_was_saved_is_the_same_when_loaded(tmp_path, room: Room, learned: NoiseModel):
    learned.save(tmp_path / "noise.npz")
    again = NoiseModel.load(tmp_path / "noise.npz")
    recording = room.recording(2)
    a, b = (Localizer(SENSORS, ACROSS, m).locate(recording, prior()) for m in (learned, again))
    assert (a.position == b.position).all()


def test_a_random_field_has_the_covariance_that_it_should():
    rng = np.random.default_rng(1)
    gradients = rng.normal(size=(20000, 3, 3))
    gradients = gradients + gradients.swapaxes(1, 2)
    gradients -= np.trace(gradients, axis1=1, axis2=2)[:, None, None] * np.eye(3) / 3.0
    gradients *= np.sqrt(3.0) / np.sqrt(np.mean(np.sum(gradients**2, axis=(1, 2))))
    measured = np.einsum("ja,nab,jb->nj", SENSORS.axes, gradients, SENSORS.positions)
    assert np.cov(measured.T) == pytest.approx(compute_field_covariance(SENSORS, 0.0, 1.0), rel=0.1, abs=1e-4)


def test_bad_noise_recordings_are_refused(tmp_path):
    good = np.random.default_rng(0).normal(size=(10, int(RATE)))
    with pytest.raises(InputError, match="at least one"):
        NoiseModel.learn([])
    with pytest.raises(InputError, match="lasts 0.010 s"):
        NoiseModel.learn([Recording(good[:, :200], RATE, np.inf)])
    with pytest.raises(InputError, match="agree in channels"):
        NoiseModel.learn([Recording(good, RATE, np.inf), Recording(good[:9], RATE, np.inf)])
    broken = good.copy()
    broken[3, 7] = np.nan
    with pytest.raises(InputError, match="channel 3"):
        NoiseModel.learn([Recording(broken, RATE, np.inf)])
    (tmp_path / "no.npz").write_text("no")
    with pytest.raises(InputError, match="noise model"):
        NoiseModel.load(tmp_path / "no.npz")
    with pytest.raises(InputError, match="has 9 sensors"):
        model = NoiseModel.learn([Recording(good[:9], RATE, np.inf)])
        Localizer(SENSORS, ACROSS, model).locate(Recording(good[:, :500], RATE, 0.02))
