"""Calibrates a device on a rig: resonance, damping and the largest free amplitude (the paper's Calibration protocol).

The device parameters of a robot file change with liquid, temperature and glue. Before a series of measurements the
device is placed at a known height and excited. Only the sensors' recordings are used, so that the same procedure
runs on the bench and in the simulated tank.

1. *Search*: each excitation direction in turn, until the signal-to-noise ratio suffices; a first pose.
2. *Sweep*: bursts at a range of frequencies. After any burst, a free device oscillates at its own frequency; the
   amplitude shows its resonance.
3. *Damping*: repeated strong shots, fitted with the full model at the known height, with linear and with
   exponential damping; the likelier model is kept.
4. *Stops*: the drive is raised until the amplitude no longer grows, then swept finely there. Driving beyond reduces
   the amplitude (docs/decisions/0004), so theta_max is the largest amplitude of the sweep.

Meaning of the results. theta_max is the free amplitude extrapolated back to the end of the drive, which is what a
localizer needs; the envelope there lies about 1 % above the mechanical stop, since the last peak came before. It is
measured as moment times angle: if the moment is assumed 2 % too large, it comes out 2 % too small, and poses
located with both are right. The frequency is that in the field at this place and heading: 3 uT along the magnet
shift it by 0.02 Hz, which the scatter over repeats does not show.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from smolbot.config.device import DeviceUncertainty
from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.results import Readable
from smolbot.core.sensing import DampingModel, Device, Recording
from smolbot.core.shots import Excite, Listen, RingDown, Shot
from smolbot.errors import InputError, SignalLostError

if TYPE_CHECKING:
    from smolbot.core.rig import Rig
    from smolbot.localization.device.fit import DeviceFit
    from smolbot.localization.device.ringdown import RingDownFit
    from smolbot.localization.device.thinning import Hum

EXCITATION_DIRECTIONS = ((1.0, 0.0), (0.0, 1.0), (0.7, 0.7), (0.7, -0.7))
"""Excitation mixes (x, y) tried in turn while the orientation is unknown."""

MIN_SNR = 20.0
"""Signal-to-noise ratio above which an oscillation can be measured."""

MIN_PROPORTIONALITY = 0.93
"""Amplitude over the proportionally extrapolated one below which the stops are reached."""

DAMPING_MODELS: tuple[DampingModel, DampingModel] = ("linear", "exponential")


@dataclass(frozen=True)
class SweepPoint:
    """One burst of the frequency sweep.

    Attributes
    ----------
    driven_frequency : float, in Hz
        Frequency of the excitation.
    measured_frequency : float, in Hz
        Measured frequency of the free oscillation.
    measured_frequency_std : float, in Hz
        Its standard deviation.
    strength : float, in T
        Measured amplitude.
    """

    driven_frequency: float
    measured_frequency: float
    measured_frequency_std: float
    strength: float


@dataclass(frozen=True)
class DrivePoint:
    """One burst of the drive sweep.

    Attributes
    ----------
    current : float, in A
        Peak current of the coil with the largest share.
    amplitude : float, in rad
        At the end of the drive.
    amplitude_std : float, in rad
        Its standard deviation.
    """

    current: float
    amplitude: float
    amplitude_std: float


@dataclass(frozen=True)
class CalibrationPlan:
    """Settings of a calibration.

    Attributes
    ----------
    cycles : int
        Length of a burst, in periods.
    ring_down : float, in s
        Between drive and listening; at least what the rig requires.
    sweep_span : float, in Hz
        Half width of the sweep about the assumed frequency.
    sweep_points : int
        Number of frequencies of the sweep.
    repeats : int
        Number of shots for the damping; each current near the stops is played half as often, at least twice.
    max_current : float, in A, optional
        Highest current of an excitation coil; the rig's limit if not given.
    height_std : float, in m
        Standard deviation of the known height.
    """

    cycles: int = 5
    ring_down: float = 0.02
    sweep_span: float = 6.0
    sweep_points: int = 9
    repeats: int = 4
    max_current: float | None = None
    height_std: float = 2e-4

    def __post_init__(self) -> None:
        for name in ("cycles", "sweep_points", "repeats"):
            if getattr(self, name) < 2:
                raise InputError(f"Calibration {name} must be at least 2; got {getattr(self, name)}.")
        for name in ("ring_down", "sweep_span"):
            if not 0 < getattr(self, name) < np.inf:
                raise InputError(f"Calibration {name} must be positive; got {getattr(self, name)}.")
        if not 0 <= self.height_std < np.inf:
            raise InputError(f"Calibration height_std must be 0 or more, in m, and finite; got {self.height_std}.")


@dataclass(frozen=True, repr=False)
class Calibration(Readable):
    """What was found, and how.

    Attributes
    ----------
    device : Device
        The calibrated device; moment and l0 are as believed (theta_max times moment is what is measured).
    std : DeviceUncertainty
        Scatter over repeats, and for theta_max the height's uncertainty.
    assumed : Device
    height : float, in m
        Of the rotation centre, as known to the operator.
    sweep, drives : tuple
        Every burst of both sweeps.
    evidence : float
        Difference of the BIC of the two damping models, positive for the one chosen; above 10 is decisive.
    stops_reached : bool
        If not, theta_max is the assumed one, or the largest amplitude measured if that is larger.
    shots : int
    robot, rig : str
        Names of both, where they are known.
    file : Path or None
        The device file that was written.
    """

    device: Device
    std: DeviceUncertainty
    assumed: Device
    height: float
    sweep: tuple[SweepPoint, ...]
    drives: tuple[DrivePoint, ...]
    evidence: float
    stops_reached: bool
    shots: int
    robot: str = ""
    rig: str = ""
    file: Path | None = None


def calibrate(
    rig: Rig,
    device: Device,
    height: float,
    *,
    plan: CalibrationPlan | None = None,
    hum: Hum | None = None,
    progress: Callable[[str], None] | None = None,
) -> Calibration:
    """Calibrate the device on an open rig.

    Parameters
    ----------
    rig : Rig
    device : Device
        As assumed; moment, its direction and l0 are kept.
    height : float, in m
        Known z of the cantilever's rotation centre above the sensors.
    plan : CalibrationPlan, optional
    hum : Hum, optional
        Mains lines expected in the room.
    progress : callable, optional
        Called with a sentence on each step.

    Returns
    -------
    Calibration

    Raises
    ------
    SignalLostError
        If no excitation direction makes the device oscillate strongly enough.
    InputError
        If the height or the sweep's span is out of range.
    InterlockError, RigError
        As the rig raises them.
    """
    if not 0.005 < height < 1.0:
        raise InputError(f"height must be the known z of the device above the sensors, in m; got {height:g}.")
    plan = plan or CalibrationPlan()
    if plan.sweep_span >= 0.5 * device.frequency:
        raise InputError(
            f"Calibration sweep_span must be below half the assumed frequency, {0.5 * device.frequency:g} Hz; "
            f"got {plan.sweep_span:g}."
        )
    return _Calibrator(rig, device, height, plan, hum, progress or (lambda _: None)).run()


class _Calibrator:
    """The four steps of a calibration; the estimates of `device` and pose improve from step to step."""

    def __init__(
        self,
        rig: Rig,
        device: Device,
        height: float,
        plan: CalibrationPlan,
        hum: Hum | None,
        tell: Callable[[str], None],
    ) -> None:
        self.rig, self.assumed, self.height, self.plan, self.hum, self.tell = rig, device, height, plan, hum, tell
        self.device = device
        self.ring_down = max(plan.ring_down, rig.limits.min_ring_down)
        most = rig.limits.max_excitation_current
        self.max_current = most if plan.max_current is None else min(plan.max_current, most)
        self.position: FloatArray = np.zeros(3)
        self.orientation: FloatArray = np.array([1.0, 0.0, 0.0, 0.0])
        self.shots = 0

    def run(self) -> Calibration:
        self.search()
        sweep = self.sweep_frequency()
        fits, evidence = self.measure_damping()
        drives, reached = self.sweep_drive()
        largest = max(drives, key=lambda d: d.amplitude)
        theta_max = largest.amplitude if reached else max(largest.amplitude, self.assumed.theta_max)
        theta_std = float(np.hypot(largest.amplitude_std, 3.0 * self.plan.height_std / self.height * theta_max))
        frequencies = [(f.device.frequency, f.std["frequency"]) for f in fits]
        dampings = [(f.device.damping, f.std["damping"]) for f in fits]
        frequency, frequency_std = compute_weighted_mean(
            frequencies + [(p.measured_frequency, p.measured_frequency_std) for p in sweep]
        )
        damping, damping_std = compute_weighted_mean(dampings)
        found = replace(self.device, theta_max=theta_max, frequency=frequency, damping=damping)
        std = DeviceUncertainty(theta_std, frequency_std, damping_std)
        return Calibration(
            found, std, self.assumed, self.height, tuple(sweep), tuple(drives), evidence, reached, self.shots
        )

    def search(self) -> None:
        """Find an excitation direction with a sufficient signal; estimate frequency, damping and pose roughly."""
        self.tell("searching for the signal")
        best: tuple[float, Recording, RingDownFit] | None = None
        for current in (0.3 * self.max_current, self.max_current):
            for direction in EXCITATION_DIRECTIONS:
                recording = self.play(current * np.array(direction), self.device.frequency)
                fit = self.measure_ring_down(recording, search=2.0 * self.plan.sweep_span)
                if best is None or fit.signal_to_noise > best[0]:
                    best = (fit.signal_to_noise, recording, fit)
            if best is not None and best[0] > MIN_SNR:
                break
        if best is None or best[0] < MIN_SNR:
            level = 0.0 if best is None else best[0]
            raise SignalLostError(
                f"No excitation direction makes the device ring: signal to noise {level:.1f}, at least {MIN_SNR:g} is "
                f"needed, with up to {self.max_current:g} A at {self.device.frequency:g} Hz. Is it near the coils, and "
                f"within {2.0 * self.plan.sweep_span:g} Hz of that frequency?",
                signal_to_noise=level,
                needed=MIN_SNR,
            )
        _, recording, fit = best
        self.device = replace(self.device, frequency=fit.frequency, damping=fit.damping)
        pose = self.locate(recording)
        self.position = np.array([*pose.position[:2], self.height])
        self.orientation = np.array(pose.orientation)
        self.adopt_pose(self.fit(recording))

    def sweep_frequency(self) -> list[SweepPoint]:
        """Excite at a range of frequencies, and measure the frequency of the free oscillation after each."""
        points = []
        for offset in np.linspace(-self.plan.sweep_span, self.plan.sweep_span, self.plan.sweep_points):
            driven = self.assumed.frequency + float(offset)
            self.tell(f"driving at {driven:.2f} Hz")
            recording = self.play(self.compute_mix() * self.compute_gentle_current(), driven)
            fit = self.measure_ring_down(recording, search=2.0)
            if fit.signal_to_noise > MIN_SNR:
                points.append(SweepPoint(driven, fit.frequency, fit.frequency_std, fit.strength))
        if len(points) < 2:
            raise SignalLostError("The device was detected in fewer than two bursts of the frequency sweep.")
        frequency, _ = compute_weighted_mean([(p.measured_frequency, p.measured_frequency_std) for p in points])
        self.device = replace(self.device, frequency=frequency)
        return points

    def measure_damping(self) -> tuple[list[DeviceFit], float]:
        """Fit repeated shots with both damping models at the known height; keep the likelier model."""
        recordings = []
        for i in range(self.plan.repeats):
            self.tell(f"listening to the decay, {i + 1} of {self.plan.repeats}")
            recordings.append(self.play(self.compute_mix() * self.compute_gentle_current(), self.device.frequency))
            self.adopt_pose(self.fit(recordings[-1]))
        fits: dict[DampingModel, list[DeviceFit]] = {}
        for model in DAMPING_MODELS:
            start = replace(
                self.device, damping=self.measure_ring_down(recordings[0], 1.0, model).damping, damping_model=model
            )
            fits[model] = [self.fit(recording, start) for recording in recordings]
        bic = {m: sum(f.n_data * float(np.log(f.sse / f.n_data)) for f in fits[m]) for m in DAMPING_MODELS}
        chosen = min(DAMPING_MODELS, key=bic.__getitem__)
        evidence = abs(bic["linear"] - bic["exponential"])  # as many parameters in either
        damping, _ = compute_weighted_mean([(f.device.damping, f.std["damping"]) for f in fits[chosen]])
        frequency, _ = compute_weighted_mean([(f.device.frequency, f.std["frequency"]) for f in fits[chosen]])
        self.device = replace(self.device, damping=damping, frequency=frequency, damping_model=chosen)
        return fits[chosen], evidence

    def sweep_drive(self) -> tuple[list[DrivePoint], bool]:
        """Measure amplitude against current: coarsely until it no longer grows, then finely around there."""
        current = 0.25 * self.compute_gentle_current()
        coarse = [self.measure_drive_point(current, 1)]
        while current < self.max_current * (1.0 - 1e-9):
            current = min(1.25 * current, self.max_current)
            coarse.append(self.measure_drive_point(current, 1))
            if coarse[-1].amplitude < 0.8 * extrapolate_amplitude(coarse, current):
                break
        reached = coarse[-1].amplitude < MIN_PROPORTIONALITY * extrapolate_amplitude(coarse, coarse[-1].current)
        if not reached:
            return coarse, False
        knee = max(coarse, key=lambda d: d.amplitude).current
        fine = [
            self.measure_drive_point(c, max(self.plan.repeats // 2, 2))
            for c in np.minimum(knee * np.linspace(0.84, 1.24, 11), self.max_current)
        ]
        return coarse[:1] + fine, True

    def measure_drive_point(self, current: float, repeats: int) -> DrivePoint:
        """Measure the mean amplitude at the end of bursts of `current` A, with frequency and damping known."""
        self.tell(f"driving with {current:.2f} A")
        amplitudes = []
        for _ in range(repeats):
            fit = self.fit(self.play(self.compute_mix() * current, self.device.frequency), known_time=True)
            self.adopt_pose(fit)
            amplitudes.append(fit.amplitude)
        scatter = float(np.std(amplitudes, ddof=1) / np.sqrt(repeats)) if repeats > 1 else 0.0
        return DrivePoint(float(current), float(np.mean(amplitudes)), max(scatter, fit.std["amplitude"] / repeats**0.5))

    def play(self, currents: FloatArray, frequency: float) -> Recording:
        """Play one burst, with a window that is long enough to separate decay and mains."""
        listen = float(np.clip(4.0 / max(self.device.damping, 1e-3), 1.0, self.rig.limits.max_listen))
        half_periods = max(int(listen * 2.0 * self.device.frequency), 1)
        cycles = max(min(self.plan.cycles, int(self.rig.limits.max_excitation * frequency)), 1)
        x, y = (float(c) for c in np.resize(currents, 2))
        windows = (
            Excite((x, y), frequency, cycles),
            RingDown(self.ring_down),
            Listen(half_periods, self.device.frequency),
        )
        recording = self.rig.play(Shot(windows, "search", self.rig.now()))
        self.shots += 1
        if recording is None:
            raise SignalLostError("The rig returned no recording for a shot that listens.")
        return recording

    def measure_ring_down(self, recording: Recording, search: float, model: DampingModel | None = None) -> RingDownFit:
        from smolbot.localization.device.ringdown import measure_ring_down

        return measure_ring_down(
            recording, self.rig.sensors, self.device, hum=self.hum, search=search, damping_model=model
        )

    def fit(self, recording: Recording, device: Device | None = None, *, known_time: bool = False) -> DeviceFit:
        from smolbot.localization.device.fit import fit_device

        return fit_device(
            recording, self.rig.sensors, device or self.device, self.position, self.orientation,
            fix_time=known_time, hum=self.hum,
        )  # fmt: skip

    def adopt_pose(self, fit: DeviceFit) -> None:
        """Use the pose of a fit from now on; a free device turns and drifts a little between shots."""
        self.position, self.orientation = fit.position, fit.orientation

    def locate(self, recording: Recording) -> Pose:
        """Locate without a prior in the first periods of a recording, allowing larger amplitudes than assumed."""
        from smolbot.localization.localizer import Localizer

        loose = replace(self.device, theta_max=min(1.6 * self.device.theta_max, 1.0))
        n = round(6 * recording.sample_rate / (2.0 * self.device.frequency))
        first = replace(recording, field=recording.field[:, :n])
        pose = Localizer(sensors=self.rig.sensors, device=loose).locate(first)
        if not pose.trusted:
            raise SignalLostError(
                f"The device rings, but no pose explains the recording (R² {pose.r_squared:.2f}): check the sensor "
                "places and axes of the rig file, and the moment's direction of the robot file."
            )
        return pose

    def compute_mix(self) -> FloatArray:
        """Compute the excitation mix for the estimated orientation; the largest share is 1.

        By Eq. S1, only the torque about y excites the device.
        """
        from smolbot.core.rotations import matrix_from_quaternion

        fields = self.rig.excitation_field(self.position)
        useful = fields @ (matrix_from_quaternion(self.orientation) @ self.device.drive_direction_in_body)
        largest = float(np.max(np.abs(useful)))
        if largest < 1e-9:
            raise SignalLostError(
                "No excitation coil can drive the device in this orientation: its drive direction (y x m) stands "
                "across both coils' fields. Turn it about its moment."
            )
        mixed: FloatArray = useful / largest
        return mixed

    def compute_gentle_current(self) -> float:
        """Compute the current in A that should reach two thirds of the assumed stop, without impacts."""
        from smolbot.core.drive import compute_amplitude_after_burst
        from smolbot.core.rotations import matrix_from_quaternion
        from smolbot.motion.robot import compute_magnet_inertia

        fields = self.rig.excitation_field(self.position)
        direction = matrix_from_quaternion(self.orientation) @ self.device.drive_direction_in_body
        per_ampere = abs(float(fields @ direction @ self.compute_mix()))
        inertia = compute_magnet_inertia(self.device.moment, self.device.l0)
        amplitude = compute_amplitude_after_burst(per_ampere, self.device, inertia, self.plan.cycles)
        return min(0.67 * self.assumed.theta_max / max(amplitude, 1e-9), self.max_current)


def extrapolate_amplitude(points: Sequence[DrivePoint], current: float) -> float:
    """Extrapolate the amplitude to a current, as proportional to the lower half of the points so far.

    Parameters
    ----------
    points : sequence of DrivePoint
    current : float, in A

    Returns
    -------
    float, in rad
    """
    lower = points[: max(2, len(points) // 2)]
    slope = sum(p.amplitude * p.current for p in lower) / sum(p.current**2 for p in lower)
    return slope * current


def compute_weighted_mean(values: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Compute the mean weighted by inverse variance, and its standard deviation.

    The standard deviation is enlarged if the values scatter more than their own deviations explain.

    Parameters
    ----------
    values : sequence of (float, float)
        Each a value with its standard deviation.

    Returns
    -------
    mean : float
    std : float

    Examples
    --------
    >>> mean, std = compute_weighted_mean([(1.0, 0.1), (1.2, 0.1)])
    >>> print(round(mean, 3), round(std, 3))
    1.1 0.1
    """
    means, deviations = np.array([v for v, _ in values]), np.array([max(s, 1e-300) for _, s in values])
    weights = deviations**-2 / np.sum(deviations**-2)
    mean = float(np.sum(weights * means))
    claimed = float(np.sum(deviations**-2) ** -0.5)
    excess = float(np.sum(((means - mean) / deviations) ** 2) / max(len(values) - 1, 1))
    return mean, claimed * max(1.0, excess**0.5)
