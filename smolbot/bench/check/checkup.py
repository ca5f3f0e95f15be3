"""Check of an open rig: harmless shots are played, and the measurements compared with the rig file."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from smolbot.bench.check.coils import MIN_SENSORS, CoilCheck, check_coils
from smolbot.bench.check.manual_checks import by_hand
from smolbot.bench.check.sensor_noise import MIN_DURATION, SensorNoise, measure_sensor_noise
from smolbot.core.coil_probe import Prober
from smolbot.core.rig import Checkable, CheckItem, Rig
from smolbot.core.sensing import Recording
from smolbot.core.shots import Listen, Shot
from smolbot.errors import InputError

if TYPE_CHECKING:
    from smolbot.config.rig import RigConfig

MAX_FLOOR_RATIO, MAX_SLOW_RATIO, MAX_MAINS_RATIO = 1.5, 3.0, 2.0
"""Highest allowed ratio to the rig file's values: noise floor; noise at 1 Hz, which varies by a third in a few
recordings; mains."""

MIN_FLOOR_RATIO = 0.2
"""A sensor whose noise floor is below this share of the expected one is dead."""

MAX_OFFSET_SHARE = 0.5
"""Highest allowed share of the range for a static field; the rest is for the signals."""


@dataclass(frozen=True)
class SensorCheck:
    """Measurements of one sensor without excitation, and its faults.

    Attributes
    ----------
    name : str
    offset : float, in T
        Mean.
    rms : float, in T
        Of the noise, without mains and trend.
    slow : float, in T/√Hz
        Noise density around 1 Hz.
    floor : float, in T/√Hz
        Noise density above 1/f noise.
    mains : float, in T
        Peak at the mains frequency.
    harmonics : float, in T
        Peak at all its multiples together.
    gain : float or None
        Measured response to the coils over the predicted one; None if it was not measured.
    faults : tuple of str
    """

    name: str
    offset: float
    rms: float
    slow: float
    floor: float
    mains: float
    harmonics: float
    gain: float | None
    faults: tuple[str, ...]


@dataclass(frozen=True)
class ExpectedNoise:
    """Values that the rig file predicts for a sensor; the limits are multiples of them.

    Attributes
    ----------
    slow : float, in T/√Hz
        Noise density around 1 Hz.
    floor : float, in T/√Hz
        Noise density above 1/f noise.
    mains : float, in T
        Peak at the mains frequency.
    harmonics : float, in T
        Peak at all its multiples together.
    range : float, in T
        Half width of the measuring range.
    """

    slow: float
    floor: float
    mains: float
    harmonics: float
    range: float


@dataclass(frozen=True)
class Checkup:
    """Result of a check.

    Attributes
    ----------
    devices : tuple of CheckItem
    sensors : tuple of SensorCheck
    coils : tuple of CoilCheck
        Empty if the rig cannot measure its own coils.
    expected : ExpectedNoise
    mains_frequency : float, in Hz
    manual_checks : tuple of str
        What only a person can verify.
    simulated : bool
        Whether the world is simulated, so that a person has nothing to verify.
    notes : tuple of str
        What was not checked, and why.
    """

    devices: tuple[CheckItem, ...]
    sensors: tuple[SensorCheck, ...]
    coils: tuple[CoilCheck, ...]
    expected: ExpectedNoise
    mains_frequency: float
    manual_checks: tuple[str, ...]
    simulated: bool
    notes: tuple[str, ...] = field(default=())

    @property
    def faults(self) -> list[str]:
        """Every fault, a line each."""
        found = [
            f"{d.device}: {d.what} is {d.found}" + (f", not {d.limit}" if d.limit else "")
            for d in self.devices
            if not d.ok
        ]
        found += [f"sensor {s.name}: {fault}" for s in self.sensors for fault in s.faults]
        return found + [f"coil {c.name}: {fault}" for c in self.coils for fault in c.faults]

    @property
    def ok(self) -> bool:
        """True if there is no fault."""
        return not self.faults


def check_rig(
    rig: Rig, config: RigConfig, noise_duration: float = 12.0, report: Callable[[str], None] = lambda _: None
) -> Checkup:
    """Check an open rig, and leave it as it was.

    Parameters
    ----------
    rig : Rig
    config : RigConfig
        The rig file that it is compared with.
    noise_duration : float, in s
        How long to record background noise, in all.
    report : callable
        Called with a sentence on each step.

    Returns
    -------
    Checkup

    Raises
    ------
    InputError
        If the time to record is too short, or if the rig's limits allow less than a second at once.
    InterlockError, RigError
        As `Rig.play`.
    """
    devices = tuple(rig.checks()) if isinstance(rig, Checkable) else ()
    report(f"listening to nothing for {noise_duration:g} s")
    noise = config.sections.noise
    recordings = _record_noise(rig, noise_duration, noise.mains_hz)
    hum = measure_sensor_noise(recordings, noise.mains_hz, rig.sensors.bandwidth)
    expected = _predict_noise(config)
    faults = _find_noise_faults(hum, expected)
    usable = np.array([not any("dead" in f or "saturated" in f for f in of_one) for of_one in faults])
    coils: tuple[CoilCheck, ...] = ()
    gains: list[float | None] = [None] * len(rig.sensors)
    notes: list[str] = []
    if not isinstance(rig, Prober):
        notes.append("This rig cannot measure its own coils while they are driven: coils and relays were not checked.")
    elif usable.sum() < MIN_SENSORS:
        notes.append(f"Fewer than {MIN_SENSORS} sensors can be relied on: coils and relays were not checked.")
    else:
        coils, responses = check_coils(rig, config, usable, expected.range, report)
        for number, likeness in enumerate(responses):
            gains[number] = likeness.gain
            if likeness.fault and usable[number]:
                faults[number].append(likeness.fault)
    names = _format_sensor_names(config, len(rig.sensors))
    sensors = tuple(
        SensorCheck(
            names[k], float(hum.offset[k]), float(hum.rms[k]), float(hum.slow[k]), float(hum.floor[k]),
            float(hum.mains[k]), float(np.linalg.norm(hum.harmonics[k])), gains[k], tuple(faults[k]),
        )
        for k in range(len(names))
    )  # fmt: skip
    return Checkup(
        devices, sensors, coils, expected, hum.mains_frequency, tuple(by_hand(config)),
        rig.witness is not None, tuple(notes),
    )  # fmt: skip


def _record_noise(rig: Rig, duration: float, mains: float) -> list[Recording]:
    if not duration >= MIN_DURATION:
        raise InputError(f"A check listens to nothing for at least {MIN_DURATION:g} s; got {duration:g} s.")
    count = max(math.ceil(duration / rig.limits.max_listen - 1e-9), 1)
    half_periods = max(round(2 * mains * min(duration / count, rig.limits.max_listen) - 0.5 + 1e-9), 1)
    recordings: list[Recording] = []
    for _ in range(count):
        recording = rig.play(Shot((Listen(half_periods, mains),), "quiet", rig.now()))
        if recording is not None:
            recordings.append(recording)
    return recordings


def _predict_noise(config: RigConfig) -> ExpectedNoise:
    noise, sensors = config.sections.noise, config.sections.sensors
    reach = float(np.linalg.norm(config.sensors.positions - config.sensors.positions.mean(axis=0), axis=1).max())
    mains = noise.mains + noise.mains_gradient * reach
    return ExpectedNoise(
        slow=max(noise.at_1hz, noise.floor),
        floor=noise.floor,
        mains=mains,
        harmonics=mains * math.sqrt(sum(size**2 for size in noise.harmonics.values())),
        range=min(sensors.range, sensors.adc_range_v / sensors.volts_per_tesla),
    )


def _find_noise_faults(hum: SensorNoise, expected: ExpectedNoise) -> list[list[str]]:
    found: list[list[str]] = [[] for _ in hum.floor]
    for k, faults in enumerate(found):
        if hum.span[k] == 0.0:
            faults.append("dead: every sample is the same")
        elif hum.floor[k] < MIN_FLOOR_RATIO * expected.floor:
            faults.append(f"dead: {1e12 * hum.floor[k]:.2g} pT/√Hz is less than a working one's noise")
        if hum.saturated[k]:
            faults.append("saturated")
        if abs(hum.offset[k]) > MAX_OFFSET_SHARE * expected.range:
            share = 100 * abs(hum.offset[k]) / expected.range
            faults.append(f"offset takes {share:.0f} % of its range")
        for what, value, should, times, scale, unit in (
            ("noise floor", hum.floor[k], expected.floor, MAX_FLOOR_RATIO, 1e12, "pT/√Hz"),
            ("noise at 1 Hz", hum.slow[k], expected.slow, MAX_SLOW_RATIO, 1e12, "pT/√Hz"),
            ("mains", hum.mains[k], expected.mains, MAX_MAINS_RATIO, 1e9, "nT"),
            ("harmonics", float(np.linalg.norm(hum.harmonics[k])), expected.harmonics, MAX_MAINS_RATIO, 1e9, "nT"),
        ):
            if should > 0 and value > times * should:
                faults.append(f"{what} {scale * value:.3g} {unit}, {value / should:.1f} times what is expected")
    return found


def _format_sensor_names(config: RigConfig, count: int) -> list[str]:
    inputs = config.raw_section("bench").get("inputs", {}).get("channels", [])
    if len(inputs) != count:
        return [str(k) for k in range(count)]
    return [f"{k} ({channel})" for k, channel in enumerate(inputs)]
