"""A simulated bench without liquid, coils or Bullet: sensors, noise and magnet, with a device at given poses.

For studies of localization alone. Readings are computed by `sim.tank.magnetics.true_sensors`, as in the tank; only
the oscillation is given in closed form, and poses come from a stage instead of hydrodynamics.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sim.tank.magnetics.device_packing import pack_device
from sim.tank.magnetics.true_sensors import TrueSensors
from sim.tank.mismatch import RandomStreams, TankTruth, sample_truth
from sim.tank.settings import TankSettings
from smolbot.config.rig import RigConfig
from smolbot.core.arrays import BoolArray, FloatArray, as_floats
from smolbot.core.sensing import Device, Recording, SensorArray
from smolbot.core.shots import Excite
from smolbot.errors import InputError

DRIVE_CYCLES, DRIVE_CURRENT = 5, 5.0  # of the drive that a recording names; the current in A, in both coils
MAX_BACKGROUND_DURATION = 2.0  # s: of one background recording
TRACK_STEP = 2.5e-4  # s: between two poses of a moving device; linear between them
PAUSE_RANGE = (0.05, 1.05)  # s: random pause between recordings, for another phase of the mains each time
ROUNDING = 1e-9  # share of a sample or recording

Track = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Positions (n, 3) in m and orientations (n, 4) at times (n,) in s from a recording's first sample."""

Disturbance = Callable[[FloatArray, FloatArray], FloatArray]
"""Field (n_sensors, n, 3) in T at times (n,) in s from a recording's first sample, at places (n_sensors, 3) in m."""


@dataclass(frozen=True)
class TrueOscillation:
    """The true oscillation of one recording, for a study's evaluation only.

    Attributes
    ----------
    amplitude : float, in rad
        At the end of the drive.
    phase : float, in rad
    """

    amplitude: float
    phase: float


class StaticBench:
    """Makes recordings of a device that is held still or moves along a known track.

    Parameters
    ----------
    rig : RigConfig
        Sensors, noise and mismatches; see `with_sensors` for another layout.
    device : Device
        As assumed.
    seed : int
        Of all samples: mismatches, lines, noise, constants, phases, times between recordings.
    mismatch_scale : float
        Of the rig file's mismatches; 0 is the ideal bench.

    Attributes
    ----------
    sensors, device : SensorArray, Device
        As assumed: what a localizer may use.
    rate : float, in Hz
    clock : float, in s
        Bench time; runs on from recording to recording.
    truth : TankTruth
    true_device : Device
        As sampled. For a study's evaluation only, like `true_sensors` and `last_oscillation`.
    true_sensors : TrueSensors
    last_oscillation : Swing or None
        Of the last recording.

    Raises
    ------
    InputError
        If `mismatch_scale` is negative.

    Examples
    --------
    >>> from smolbot.config.rig import load_rig
    >>> device = Device(0.89e-3, np.array([1.0, 0, 0]), 1.5e-3, np.radians(17.8), 103.5, 1.1, "linear")
    >>> bench = StaticBench(load_rig("tank"), device, seed=1, mismatch_scale=0.0)
    >>> recording = bench.record(np.array([0, 0, 0.08]), np.array([1.0, 0, 0, 0]), half_periods=2)
    >>> print(recording.field.shape, recording.time_since_drive)
    (10, 483) 0.02
    >>> print(round(float(np.degrees(bench.last_oscillation.amplitude)), 1))
    17.8
    """

    def __init__(self, rig: RigConfig, device: Device, seed: int, mismatch_scale: float = 1.0) -> None:
        if not 0 <= mismatch_scale < np.inf:
            raise InputError(f"mismatch_scale must not be negative; got {mismatch_scale}.")
        settings = rig.section_of("tank", TankSettings)
        mismatch = settings.mismatch.model_copy(update={"scale": float(mismatch_scale)})
        streams = RandomStreams.from_seed(seed)
        self.truth: TankTruth = sample_truth(
            settings.model_copy(update={"mismatch": mismatch}), len(rig.driven), len(rig.sensors), streams
        )
        self.true_sensors = TrueSensors(rig, self.truth, streams.field_noise, streams.sensor_noise, streams.constants)
        self.sensors: SensorArray = rig.sensors
        self.device = device
        self.rate = rig.sample_rate
        self._gains = rig.sensor_gains[:, None]
        self.clock = 0.0
        self.last_oscillation: TrueOscillation | None = None
        self._rng = np.random.Generator(np.random.SFC64(np.random.SeedSequence([seed, 1])))
        self.true_device = d = self.truth.apply_to_device(device)
        self._magnet = pack_device(
            d.moment, d.moment_in_body, d.l0, d.theta_max, d.frequency, d.damping, d.damping_model, 0.0, (0.0, 0.0, 0.0)
        )
        self._lead = math.ceil(self.true_sensors.lead * self.rate) + 1

    def count_samples(self, half_periods: int) -> int:
        """Return the number of samples in a window.

        Parameters
        ----------
        half_periods : int
            Length of the window, in half-periods of the assumed frequency.

        Returns
        -------
        int
        """
        return round(half_periods * self.rate / (2.0 * self.device.frequency))

    def record(
        self,
        position: FloatArray,
        orientation: FloatArray,
        half_periods: int,
        time_since_drive: float = 0.02,
        amplitude: float | None = None,
        phase: float | None = None,
        disturbance: Disturbance | None = None,
    ) -> Recording:
        """Make a recording of a device that is held still.

        Parameters
        ----------
        position : ndarray, shape (3,), in m
            Rotation centre of the cantilever, world frame.
        orientation : ndarray, shape (4,)
            Unit quaternion, scalar first.
        half_periods : int
            Length, in half-periods of the assumed frequency.
        time_since_drive : float, in s
            From the end of the drive to the first sample.
        amplitude : float, in rad, optional
            Of the oscillation at the end of the drive; at the true stop if not given.
        phase : float, in rad, optional
            Of the oscillation at the end of the drive; sampled if not given.
        disturbance : callable, optional
            Another field that the sensors measure.

        Returns
        -------
        Recording
        """
        place = as_floats(position, (3,), "record position")
        turn = as_floats(orientation, (4,), "record orientation")
        n, swing = self.count_samples(half_periods), self._sample_oscillation(amplitude, phase)
        poses = np.tile(np.concatenate([place, turn]), (2, 1))
        field = self._compute_clean_field(n, time_since_drive, swing, np.array([-1.0, n / self.rate]), poses)
        return self._measure(field, time_since_drive, disturbance)

    def record_track(
        self,
        track: Track,
        half_periods: int,
        time_since_drive: float = 0.02,
        amplitude: float | None = None,
        phase: float | None = None,
        disturbance: Disturbance | None = None,
    ) -> Recording:
        """Make a recording of a device that moves along a known track.

        Parameters
        ----------
        track : callable
            Called with times from some milliseconds before the first sample on, because of the sensors' low pass.
        half_periods : int
            Length, in half-periods of the assumed frequency.
        time_since_drive : float, in s
            From the end of the drive to the first sample.
        amplitude : float, in rad, optional
            Of the oscillation at the end of the drive; at the true stop if not given.
        phase : float, in rad, optional
            Of the oscillation at the end of the drive; sampled if not given.
        disturbance : callable, optional
            Another field that the sensors measure.

        Returns
        -------
        Recording
        """
        n, swing = self.count_samples(half_periods), self._sample_oscillation(amplitude, phase)
        begin, end = -self._lead / self.rate, n / self.rate
        times = np.linspace(begin, end, max(math.ceil((end - begin) / TRACK_STEP), 1) + 1)
        places, turns = track(times)
        turns = as_floats(turns, (len(times), 4), "track orientations")
        signs = np.cumprod(np.concatenate([[1.0], np.sign(np.sum(turns[1:] * turns[:-1], axis=1))]))
        # one sign for all quaternions: they are interpolated
        poses = np.concatenate([as_floats(places, (len(times), 3), "track positions"), turns * signs[:, None]], axis=1)
        field = self._compute_clean_field(n, time_since_drive, swing, times, poses)
        return self._measure(field, time_since_drive, disturbance)

    def record_background(self, seconds: float, disturbance: Disturbance | None = None) -> list[Recording]:
        """Make background noise recordings, without an oscillation.

        Parameters
        ----------
        seconds : float, in s
            Total length. No recording is longer than two seconds.
        disturbance : callable, optional
            Another field that the sensors measure.

        Returns
        -------
        list of Recording
        """
        count = max(math.ceil(seconds / MAX_BACKGROUND_DURATION - ROUNDING), 1)
        n = math.ceil(seconds * self.rate / count - ROUNDING)
        return [self._measure(np.zeros((len(self.sensors), n)), np.inf, disturbance) for _ in range(count)]

    def compute_clean_readings(
        self,
        position: FloatArray,
        orientation: FloatArray,
        n: int,
        time_since_drive: float = 0.02,
        amplitude: float | None = None,
        phase: float = 0.0,
    ) -> FloatArray:
        """Compute noiseless readings of a device that is held still, without advancing random generators or clock.

        Parameters
        ----------
        position : ndarray, shape (3,), in m
            Rotation centre of the cantilever, world frame.
        orientation : ndarray, shape (4,)
            Unit quaternion, scalar first.
        n : int
            Number of samples.
        time_since_drive : float, in s
            From the end of the drive to the first sample.
        amplitude : float, in rad, optional
            Of the oscillation at the end of the drive; at the true stop if not given.
        phase : float, in rad
            Of the oscillation at the end of the drive.

        Returns
        -------
        ndarray, shape (n_sensors, n), in T
        """
        size = self.true_device.theta_max if amplitude is None else amplitude
        poses = np.tile(np.concatenate([position, orientation]), (2, 1))
        return self._compute_clean_field(
            n, time_since_drive, TrueOscillation(size, phase), np.array([-1.0, n / self.rate]), poses
        )

    def _sample_oscillation(self, amplitude: float | None, phase: float | None) -> TrueOscillation:
        sampled = float(self._rng.uniform(-np.pi, np.pi))  # sampled even if given: what follows does not change
        size = self.true_device.theta_max if amplitude is None else amplitude
        self.last_oscillation = TrueOscillation(size, sampled if phase is None else phase)
        return self.last_oscillation

    def _compute_clean_field(
        self, n: int, since: float, swing: TrueOscillation, pose_times: FloatArray, poses: FloatArray
    ) -> FloatArray:
        """Compute the readings of an oscillation in closed form (Eqs. S2 to S4), after the sensors' low pass."""
        device = self.true_device
        times = np.arange(-self._lead, n + 1) / self.rate
        after = np.maximum(since + times, 0.0)
        if device.damping_model == "linear":
            envelope = np.maximum(1.0 - device.damping * after, 0.0)
        else:
            envelope = np.exp(-device.damping * after)
        theta = swing.amplitude * envelope * np.cos(2 * np.pi * device.frequency * (since + times) + swing.phase)
        coupling = np.zeros((0, len(self.sensors)))
        return self.true_sensors.compute_clean_readings(
            0.0, n, self._magnet, coupling, times, theta[:, None], pose_times, poses
        )

    def _measure(self, field: FloatArray, since: float, disturbance: Disturbance | None) -> Recording:
        """Add disturbance, noise, constants and conversion errors, and advance the bench's clock."""
        n = field.shape[1]
        if disturbance is not None:
            field += self._measure_disturbance(disturbance, n)
        clock = self.clock
        saturated: BoolArray = self.true_sensors.measure(field, clock)
        self.clock = clock + n / self.rate + float(self._rng.uniform(*PAUSE_RANGE))
        drive = (
            Excite((DRIVE_CURRENT, DRIVE_CURRENT), self.device.frequency, DRIVE_CYCLES) if np.isfinite(since) else None
        )
        return Recording(field / self._gains, self.rate, since, saturated, drive, clock)

    def _measure_disturbance(self, disturbance: Disturbance, n: int) -> FloatArray:
        """Compute a disturbing field along the true sensor axes, after the sensors' low pass."""
        from scipy.signal import lfilter

        times = np.arange(-self._lead, n) / self.rate
        places = self.true_sensors.positions
        shape = (len(places), len(times), 3)
        field = as_floats(disturbance(times, places), shape, "disturbance field")
        along = np.einsum("ktj,kj->kt", field, self.true_sensors.axes)
        bandwidth = self.sensors.bandwidth
        if not np.isfinite(bandwidth):
            return np.ascontiguousarray(along[:, self._lead :])
        keep = math.exp(-2 * math.pi * bandwidth / self.rate)
        slow = lfilter([1.0 - keep], [1.0, -keep], along, axis=1, zi=keep * along[:, :1])[0]
        return np.ascontiguousarray(slow[:, self._lead :])


def with_sensors(rig: RigConfig, positions: FloatArray, axes: FloatArray) -> RigConfig:
    """Return a copy of a rig with another sensor layout.

    Parameters
    ----------
    rig : RigConfig
    positions : ndarray, shape (n, 3), in m
        World frame.
    axes : ndarray, shape (n, 3)
        Sensitive directions, world frame.

    Returns
    -------
    RigConfig

    Raises
    ------
    InputError
        If the numbers of positions and axes differ.
    """
    places = as_floats(positions, (None, 3), "with_sensors positions")
    directions = as_floats(axes, (None, 3), "with_sensors axes")
    if len(places) != len(directions):
        raise InputError(f"{len(places)} positions but {len(directions)} axes; each sensor needs both.")
    update = {
        "positions_mm": [tuple(1e3 * float(v) for v in row) for row in places],
        "axes": [tuple(float(v) for v in row) for row in directions],
        "gains": None,
        "calibrated": None,
    }
    section = rig.sections.sensors.model_copy(update=update)
    return RigConfig(rig.document, rig.sections.model_copy(update={"sensors": section}))
