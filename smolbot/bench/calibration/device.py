"""Calibrates a device on a rig: resonance, damping and the largest free amplitude (the paper's Calibration protocol).

What a robot file believes about a device changes with liquid, temperature and glue. Before a series of
measurements the device is put at a known height and driven; nothing but what the sensors hear is used,
so the same procedure runs on the bench and in the simulated tank.

1. *Search*: each excitation direction in turn, until one is heard well; a first pose.
2. *Sweep*: bursts at a range of frequencies. However it is driven, a free device rings at its own
   frequency; how strongly, shows its resonance.
3. *Damping*: repeated strong shots, fitted with the full model at the known height, with linear and with
   exponential damping; the data say which.
4. *Stops*: the drive is raised until the amplitude follows no longer, then searched finely there. Driving
   beyond loses amplitude (docs/decisions/0004), so theta_max is the largest amplitude of the sweep.

What the figures mean. theta_max is the free amplitude carried back to the end of the drive, which is what a
localizer needs; the envelope there lies about 1 % above the mechanical stop, since the last peak came before.
It is heard as moment times angle: with a moment that is 2 % less than believed, it comes out 2 % low, and poses
located with both are right. The frequency is that in the field at this place and heading: 3 uT along the magnet
shift it by 0.02 Hz, which the scatter over repeats does not show.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from smolbot.config.device import Uncertainty
from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.results import Readable, as_columns
from smolbot.core.sensing import DampingModel, Device, Recording
from smolbot.core.shots import Excite, Listen, RingDown, Shot
from smolbot.errors import InputError, SignalLostError

if TYPE_CHECKING:
    from smolbot.core.rig import Rig
    from smolbot.localization.device.fit import DeviceFit
    from smolbot.localization.device.ringdown import RingDownFit
    from smolbot.localization.device.thinning import Hum

DIRECTIONS = ((1.0, 0.0), (0.0, 1.0), (0.7, 0.7), (0.7, -0.7))
"""Excitation mixes (x, y) tried in turn while the orientation is unknown."""

HEARD = 20.0
"""Signal to noise above which an oscillation can be measured."""

FOLLOWS = 0.93
"""Below this share of proportional growth the amplitude no longer follows the drive: the stops are reached."""

MODELS: tuple[DampingModel, DampingModel] = ("linear", "exponential")


@dataclass(frozen=True)
class SweepPoint:
    """One burst of the frequency sweep: Hz driven, Hz heard and its standard deviation, T heard."""

    driven: float
    heard: float
    heard_std: float
    strength: float


@dataclass(frozen=True)
class DrivePoint:
    """One burst of the drive sweep: largest coil current in A, amplitude at the end of the drive in rad."""

    current: float
    amplitude: float
    amplitude_std: float


@dataclass(frozen=True)
class Plan:
    """How a calibration is played. SI units.

    Attributes
    ----------
    cycles : int
        Length of a burst, in periods.
    ring_down : float, in s
        Between drive and listening; at least what the rig asks for.
    sweep_span : float, in Hz
        The sweep reaches so far to both sides of the believed frequency.
    sweep_points : int
    repeats : int
        Shots from which damping comes; each current near the stops is played half as often, at least twice.
    max_current : float, in A, optional
        Most that an excitation coil gets; the rig's limit if not given.
    height_std : float, in m
        Uncertainty of the known height.
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
    std : Uncertainty
        Scatter over repeats, and for theta_max the height's uncertainty.
    believed : Device
    height : float, in m
        Of the rotation centre, as known to the operator.
    sweep, drives : tuple
        Every burst of both sweeps.
    evidence : float
        Difference of the BIC of the two damping models, positive for the one chosen; above 10 is decisive.
    stops_reached : bool
        If not, theta_max is the believed one, or the largest amplitude seen if that is larger.
    shots : int
    robot, rig : str
        Names of both, where they are known.
    file : Path or None
        The device file that was written.
    """

    device: Device
    std: Uncertainty
    believed: Device
    height: float
    sweep: tuple[SweepPoint, ...]
    drives: tuple[DrivePoint, ...]
    evidence: float
    stops_reached: bool
    shots: int
    robot: str = ""
    rig: str = ""
    file: Path | None = None

    def sweep_table(self) -> dict[str, np.ndarray[Any, Any]]:
        """The fields of `SweepPoint` as arrays, a value for each burst of the frequency sweep."""
        return as_columns(map(asdict, self.sweep), [f.name for f in fields(SweepPoint)])

    def drive_table(self) -> dict[str, np.ndarray[Any, Any]]:
        """The fields of `DrivePoint` as arrays, a value for each current of the drive sweep."""
        return as_columns(map(asdict, self.drives), [f.name for f in fields(DrivePoint)])


def calibrate(
    rig: Rig,
    device: Device,
    height: float,
    *,
    plan: Plan | None = None,
    hum: Hum | None = None,
    progress: Callable[[str], None] | None = None,
) -> Calibration:
    """Calibrate the device on an open rig.

    Parameters
    ----------
    rig : Rig
    device : Device
        As believed; moment, its direction and l0 are kept.
    height : float, in m
        Known z of the cantilever's rotation centre above the sensors.
    plan : Plan, optional
    hum : Hum, optional
        Mains lines expected in the room.
    progress : callable, optional
        Told what is being done, a sentence at a time.

    Raises
    ------
    SignalLostError
        If no excitation direction makes the device ring loudly enough.
    InputError, InterlockError, RigError
        For a height or a sweep of no use; as the rig raises them.
    """
    if not 0.005 < height < 1.0:
        raise InputError(f"height must be the known z of the device above the sensors, in m; got {height:g}.")
    plan = plan or Plan()
    if plan.sweep_span >= 0.5 * device.frequency:
        raise InputError(
            f"Calibration sweep_span must be below half the believed frequency, {0.5 * device.frequency:g} Hz; "
            f"got {plan.sweep_span:g}."
        )
    return _Calibrator(rig, device, height, plan, hum, progress or (lambda _: None)).run()


class _Calibrator:
    """The four steps; `device` and `pose` get better from one to the next."""

    def __init__(
        self, rig: Rig, device: Device, height: float, plan: Plan, hum: Hum | None, tell: Callable[[str], None]
    ) -> None:
        self.rig, self.believed, self.height, self.plan, self.hum, self.tell = rig, device, height, plan, hum, tell
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
        theta_max = largest.amplitude if reached else max(largest.amplitude, self.believed.theta_max)
        theta_std = float(np.hypot(largest.amplitude_std, 3.0 * self.plan.height_std / self.height * theta_max))
        frequencies = [(f.device.frequency, f.std["frequency"]) for f in fits]
        dampings = [(f.device.damping, f.std["damping"]) for f in fits]
        frequency, frequency_std = weighted_mean(frequencies + [(p.heard, p.heard_std) for p in sweep])
        damping, damping_std = weighted_mean(dampings)
        found = replace(self.device, theta_max=theta_max, frequency=frequency, damping=damping)
        std = Uncertainty(theta_std, frequency_std, damping_std)
        return Calibration(
            found, std, self.believed, self.height, tuple(sweep), tuple(drives), evidence, reached, self.shots
        )

    def search(self) -> None:
        """Find a direction that makes the device ring; measure frequency and damping roughly, and the pose."""
        self.tell("searching for the signal")
        best: tuple[float, Recording, RingDownFit] | None = None
        for current in (0.3 * self.max_current, self.max_current):
            for direction in DIRECTIONS:
                heard = self.play(current * np.array(direction), self.device.frequency)
                fit = self.ringing(heard, search=2.0 * self.plan.sweep_span)
                if best is None or fit.signal_to_noise > best[0]:
                    best = (fit.signal_to_noise, heard, fit)
            if best is not None and best[0] > HEARD:
                break
        if best is None or best[0] < HEARD:
            level = 0.0 if best is None else best[0]
            raise SignalLostError(
                f"No excitation direction makes the device ring: signal to noise {level:.1f}, at least {HEARD:g} is "
                f"needed, with up to {self.max_current:g} A at {self.device.frequency:g} Hz. Is it near the coils, and "
                f"within {2.0 * self.plan.sweep_span:g} Hz of that frequency?",
                signal_to_noise=level,
                needed=HEARD,
            )
        _, heard, fit = best
        self.device = replace(self.device, frequency=fit.frequency, damping=fit.damping)
        pose = self.locate(heard)
        self.position = np.array([*pose.position[:2], self.height])
        self.orientation = np.array(pose.orientation)
        self.take(self.fit(heard))

    def sweep_frequency(self) -> list[SweepPoint]:
        """Drive at a range of frequencies; the free oscillation keeps its own."""
        points = []
        for offset in np.linspace(-self.plan.sweep_span, self.plan.sweep_span, self.plan.sweep_points):
            driven = self.believed.frequency + float(offset)
            self.tell(f"driving at {driven:.2f} Hz")
            heard = self.play(self.mix() * self.gentle(), driven)
            fit = self.ringing(heard, search=2.0)
            if fit.signal_to_noise > HEARD:
                points.append(SweepPoint(driven, fit.frequency, fit.frequency_std, fit.strength))
        if len(points) < 2:
            raise SignalLostError("The device was heard in fewer than two bursts of the frequency sweep.")
        frequency, _ = weighted_mean([(p.heard, p.heard_std) for p in points])
        self.device = replace(self.device, frequency=frequency)
        return points

    def measure_damping(self) -> tuple[list[DeviceFit], float]:
        """Repeated shots, fitted with both kinds of damping at the known height; keep the likelier kind."""
        heard = []
        for i in range(self.plan.repeats):
            self.tell(f"listening to the decay, {i + 1} of {self.plan.repeats}")
            heard.append(self.play(self.mix() * self.gentle(), self.device.frequency))
            self.take(self.fit(heard[-1]))
        fits: dict[DampingModel, list[DeviceFit]] = {}
        for model in MODELS:
            start = replace(self.device, damping=self.ringing(heard[0], 1.0, model).damping, damping_model=model)
            fits[model] = [self.fit(recording, start) for recording in heard]
        bic = {m: sum(f.n_data * float(np.log(f.sse / f.n_data)) for f in fits[m]) for m in MODELS}
        chosen = min(MODELS, key=bic.__getitem__)
        evidence = abs(bic["linear"] - bic["exponential"])  # as many parameters in either
        damping, _ = weighted_mean([(f.device.damping, f.std["damping"]) for f in fits[chosen]])
        frequency, _ = weighted_mean([(f.device.frequency, f.std["frequency"]) for f in fits[chosen]])
        self.device = replace(self.device, damping=damping, frequency=frequency, damping_model=chosen)
        return fits[chosen], evidence

    def sweep_drive(self) -> tuple[list[DrivePoint], bool]:
        """Amplitude against current: coarsely up to where it follows no longer, then finely around there."""
        current = 0.25 * self.gentle()
        coarse = [self.drive_point(current, 1)]
        while current < self.max_current * (1.0 - 1e-9):
            current = min(1.25 * current, self.max_current)
            coarse.append(self.drive_point(current, 1))
            if coarse[-1].amplitude < 0.8 * proportional(coarse, current):
                break
        reached = coarse[-1].amplitude < FOLLOWS * proportional(coarse, coarse[-1].current)
        if not reached:
            return coarse, False
        knee = max(coarse, key=lambda d: d.amplitude).current
        fine = [
            self.drive_point(c, max(self.plan.repeats // 2, 2))
            for c in np.minimum(knee * np.linspace(0.84, 1.24, 11), self.max_current)
        ]
        return coarse[:1] + fine, True

    def drive_point(self, current: float, repeats: int) -> DrivePoint:
        """Mean amplitude at the end of bursts of `current`, with frequency and damping known."""
        self.tell(f"driving with {current:.2f} A")
        amplitudes = []
        for _ in range(repeats):
            fit = self.fit(self.play(self.mix() * current, self.device.frequency), known_time=True)
            self.take(fit)
            amplitudes.append(fit.amplitude)
        scatter = float(np.std(amplitudes, ddof=1) / np.sqrt(repeats)) if repeats > 1 else 0.0
        return DrivePoint(float(current), float(np.mean(amplitudes)), max(scatter, fit.std["amplitude"] / repeats**0.5))

    def play(self, currents: FloatArray, frequency: float) -> Recording:
        """One burst and a long window, long enough for the decay and for the mains to be told from it."""
        listen = float(np.clip(4.0 / max(self.device.damping, 1e-3), 1.0, self.rig.limits.max_listen))
        half_periods = max(int(listen * 2.0 * self.device.frequency), 1)
        cycles = max(min(self.plan.cycles, int(self.rig.limits.max_excitation * frequency)), 1)
        x, y = (float(c) for c in np.resize(currents, 2))
        windows = (
            Excite((x, y), frequency, cycles),
            RingDown(self.ring_down),
            Listen(half_periods, self.device.frequency),
        )
        heard = self.rig.play(Shot(windows, "search", self.rig.now()))
        self.shots += 1
        if heard is None:
            raise SignalLostError("The rig returned no recording for a shot that listens.")
        return heard

    def ringing(self, heard: Recording, search: float, model: DampingModel | None = None) -> RingDownFit:
        from smolbot.localization.device.ringdown import measure

        return measure(heard, self.rig.sensors, self.device, hum=self.hum, search=search, damping_model=model)

    def fit(self, heard: Recording, device: Device | None = None, *, known_time: bool = False) -> DeviceFit:
        from smolbot.localization.device.fit import fit_device

        return fit_device(
            heard, self.rig.sensors, device or self.device, self.position, self.orientation,
            fix_time=known_time, hum=self.hum,
        )  # fmt: skip

    def take(self, fit: DeviceFit) -> None:
        """Believe a fit's pose from now on; a free device turns and drifts a little between shots."""
        self.position, self.orientation = fit.position, fit.orientation

    def locate(self, heard: Recording) -> Pose:
        """First pose, cold: from the first periods of the window, with an amplitude that may exceed the belief."""
        from smolbot.localization.localizer import Localizer

        loose = replace(self.device, theta_max=min(1.6 * self.device.theta_max, 1.0))
        n = round(6 * heard.sample_rate / (2.0 * self.device.frequency))
        first = replace(heard, field=heard.field[:, :n])
        pose = Localizer(sensors=self.rig.sensors, device=loose).locate(first)
        if not pose.trusted:
            raise SignalLostError(
                f"The device rings, but no pose explains what is heard (R² {pose.r_squared:.2f}): check the sensor "
                "places and axes of the rig file, and the moment's direction of the robot file."
            )
        return pose

    def mix(self) -> FloatArray:
        """Excitation mix for the believed orientation: the largest coil has 1 (Eq. S1: only the torque about y)."""
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

    def gentle(self) -> float:
        """Current in A that should leave about two thirds of the believed stop: strong, and free of impacts."""
        from smolbot.core.drive import amplitude_after
        from smolbot.core.rotations import matrix_from_quaternion
        from smolbot.motion.robot import magnet_inertia

        fields = self.rig.excitation_field(self.position)
        direction = matrix_from_quaternion(self.orientation) @ self.device.drive_direction_in_body
        per_ampere = abs(float(fields @ direction @ self.mix()))
        inertia = magnet_inertia(self.device.moment, self.device.l0)
        amplitude = amplitude_after(per_ampere, self.device, inertia, self.plan.cycles)
        return min(0.67 * self.believed.theta_max / max(amplitude, 1e-9), self.max_current)


def proportional(points: Sequence[DrivePoint], current: float) -> float:
    """Amplitude at `current` if it grew as at the lower half of the points so far, in rad."""
    lower = points[: max(2, len(points) // 2)]
    slope = sum(p.amplitude * p.current for p in lower) / sum(p.current**2 for p in lower)
    return slope * current


def weighted_mean(values: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Mean of (value, standard deviation) pairs weighed by precision, and its standard deviation.

    The deviation is that of the weights, or of the scatter where the values scatter more than they claim.

    Examples
    --------
    >>> mean, std = weighted_mean([(1.0, 0.1), (1.2, 0.1)])
    >>> print(round(mean, 3), round(std, 3))
    1.1 0.1
    """
    means, deviations = np.array([v for v, _ in values]), np.array([max(s, 1e-300) for _, s in values])
    weights = deviations**-2 / np.sum(deviations**-2)
    mean = float(np.sum(weights * means))
    claimed = float(np.sum(deviations**-2) ** -0.5)
    excess = float(np.sum(((means - mean) / deviations) ** 2) / max(len(values) - 1, 1))
    return mean, claimed * max(1.0, excess**0.5)
