"""The reduced rig: implements `smolbot.core.rig.Rig`, but returns simulated pose fixes instead of signals."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sim.reduced.fit_errors import FitErrors, SignalSource, make_true_noise_model
from sim.reduced.kernel import OSCILLATION
from sim.reduced.plant import ReducedPlant
from sim.tank.history import TankWitness
from sim.tank.magnetics.tank_coils import TabulatedExcitation
from sim.tank.settings import TankSettings
from smolbot.config.load import AnyMission
from smolbot.config.rig import RigConfig
from smolbot.config.robot import RobotConfig
from smolbot.core.arrays import FloatArray, as_floats
from smolbot.core.rig import Witness
from smolbot.core.rotations import flip_orientation
from smolbot.core.sensing import Recording
from smolbot.core.shots import Listen, Rest, Shot
from smolbot.errors import InputError, RigError
from smolbot.localization.estimator import PoseEstimator
from smolbot.localization.localizer import Localizer
from smolbot.localization.synthetic import SyntheticLocalizer, SyntheticRecording

AMPLITUDE_SPREAD = 0.02
"""Relative standard deviation of the amplitude from burst to burst: the oscillation left when a drive begins."""

MAX_SIGMAS = 3.0
"""Standard deviations to which it is clipped."""

FLIPS = 0.5
"""Share of recordings that fit the flipped orientation: half a turn about the moment gives the same field."""


class ReducedRig:
    """A tank without Bullet, signals and fits.

    `sim.reduced.plant` moves the robot, and `sim.reduced.fit_errors` samples the errors of its localization.

    Samples its mismatches as `sim.tank.rig.TankRig` does from the same seed; everything that it returns is labelled
    by its `provenance`.

    Parameters
    ----------
    rig : RigConfig
    robot : RobotConfig
    settings : TankSettings
    start : ndarray, shape (2,), in m
        Requested start position (x, y), world frame.
    seed : int
    ideal : bool
        Sample no mismatch.

    Attributes
    ----------
    sensors : SensorArray
        At their nominal positions.
    limits : Limits
    witness : Witness or None
        Reports true poses; may be set to None, which changes nothing else.

    Examples
    --------
    >>> from smolbot.config.rig import load_rig
    >>> from smolbot.config.robot import load_robot
    >>> from smolbot.core.shots import Actuate
    >>> rig = ReducedRig(load_rig("tank"), load_robot("gradient"), TankSettings(), np.zeros(2), seed=1)
    >>> for _ in range(20):
    ...     rig.play(Shot((Actuate((8.0, 0.0, 0.0, 0.0), 0.1),)))
    >>> print(bool(rig.witness.truth(rig.now()).position[0] > 1e-3), rig.provenance()["plant"])
    True reduced
    """

    def __init__(
        self, rig: RigConfig, robot: RobotConfig, settings: TankSettings, start: FloatArray, seed: int,
        *, ideal: bool = False,
    ) -> None:  # fmt: skip
        self.sensors = rig.sensors
        self.limits = rig.limits
        self._plant = ReducedPlant(rig, robot, settings, start, seed, ideal=ideal)
        self.witness: Witness | None = TankWitness(self._plant.history)
        self._rig, self._rate, self._turnaround = rig, rig.sample_rate, rig.turnaround
        self._no_samples = np.zeros((len(rig.sensors), 0))
        self._nominal_excitation = TabulatedExcitation(rig)
        self._device = self._plant.truth.apply_to_device(robot.device)
        self._rng = np.random.Generator(np.random.SFC64(np.random.SeedSequence([seed, 4])))
        self._errors: FitErrors | None = None
        self._seed, self._ideal = seed, ideal or settings.mismatch.scale == 0.0
        self._open = True

    def make_synthetic_localizer(self, localizer: PoseEstimator) -> SyntheticLocalizer:
        """Make the localizer of this rig: it returns poses with the errors that `localizer` would make.

        Parameters
        ----------
        localizer : PoseEstimator

        Returns
        -------
        SyntheticLocalizer

        Raises
        ------
        InputError
            If it is no `Localizer`: its errors are not known.
        """
        if not isinstance(localizer, Localizer):
            raise InputError(
                f"The reduced plant models the errors of whitened and paper, not of {type(localizer).__name__}. Fly "
                "it in the full tank: --plant full."
            )
        plant, truth = self._plant, self._plant.truth
        sensors, device = plant.sensors, self._device
        lines = 1 + len(self._rig.sections.noise.harmonics)
        gains = self._rig.sensor_gains
        phasors = sensors.field_noise.amplitudes[:lines] / gains
        room = make_true_noise_model(self._rig, truth.noise, truth.mains_frequency, phasors)
        moment = device.moment * device.moment_in_body
        source = SignalSource(sensors.positions, sensors.axes / gains[:, None], moment, device.l0, room)
        constants = tuple(c.time_constant for c in self._rig.sections.excitation)
        self._errors = FitErrors(localizer, self._rig, source, self._rng)
        return SyntheticLocalizer(localizer.sensors, localizer.device, localizer.volume, constants)

    def now(self) -> float:
        """Return the time on the plant's virtual clock.

        Returns
        -------
        float, in s
        """
        return self._plant.time

    def play(self, shot: Shot) -> Recording | None:
        """Play the windows of one shot in order.

        Parameters
        ----------
        shot : Shot

        Returns
        -------
        Recording or None
            A simulated pose fix if the shot drives and listens, an empty recording if it only listens, else None.

        Raises
        ------
        InterlockError
            Before anything moves, if the shot breaks a limit.
        RigError
            If the rig is closed.
        """
        if not self._open:
            raise RigError("This plant is closed; nothing was played.")
        self.limits.check(shot)
        begin, windows = self._plant.time, list(shot.windows)
        listening = next((i for i, w in enumerate(windows) if isinstance(w, Listen)), None)
        middle = 0.0
        if listening is not None:
            listen = windows[listening]
            middle = 0.5 * round(listen.duration * self._rate) / self._rate
            windows[listening : listening + 1] = [Rest(middle), Rest(listen.duration - middle)]
        if self._turnaround > 0:
            windows.append(Rest(self._turnaround))
        states = self._plant.advance(tuple(windows))
        if listening is None:
            return None
        start = begin + sum(w.duration for w in windows[:listening])
        return self._make_pose_fix(shot, start, middle, states[: listening + 2])

    def excitation_field(self, position: FloatArray) -> FloatArray:
        """Return the nominal field of the excitation coils at a point.

        Parameters
        ----------
        position : ndarray, shape (3,), in m
            World frame.

        Returns
        -------
        ndarray, shape (n_exc, 3), in T per A
            World frame.
        """
        return self._nominal_excitation.compute_field(as_floats(position, (3,), "excitation_field position"))

    def stop(self) -> None:
        """Bring every current to zero now."""
        self._plant.zero_currents()

    def close(self) -> None:
        """Stop for good; harmless when repeated."""
        self.stop()
        self._open = False

    def provenance(self) -> dict[str, Any]:
        """Return the plant's label, its seed, whether ideal, and every sampled mismatch.

        Returns
        -------
        dict
            Plain lists and numbers.
        """
        truth = self._plant.truth.as_dict()
        return {"plant": "reduced", "seed": self._seed, "ideal": self._ideal, "truth": truth}

    def _make_pose_fix(self, shot: Shot, start: float, middle: float, states: FloatArray) -> Recording:
        """Make the recording of a listening window from `start` s on; the last of `states` is at its middle."""
        empty, rate, drive = self._no_samples, self._rate, shot.excite
        if drive is None or self._errors is None or shot.mode == "quiet":  # without signals there is no noise to learn
            return Recording(empty, rate, math.inf, drive=drive, clock=start)
        index = max(i for i, w in enumerate(shot.windows[: len(states)]) if w is drive)
        since = sum(w.duration for w in shot.windows[index + 1 : len(states) - 2])
        truth, listen = self._plant.compute_pose(states[-1]), shot.windows[len(states) - 2]
        assert isinstance(listen, Listen)
        spread = 1.0 + AMPLITUDE_SPREAD * min(max(self._rng.standard_normal(), -MAX_SIGMAS), MAX_SIGMAS)
        amplitude = min(spread * math.hypot(*states[index + 1, OSCILLATION]), self._device.theta_max)
        orientation = truth[3:]
        if self._rng.random() < FLIPS:  # only a prior can distinguish the two
            orientation = flip_orientation(orientation)
        fitted = self._errors.sample(truth[:3], orientation, amplitude, listen.half_periods, since)
        return SyntheticRecording(empty, rate, since, drive=drive, clock=start, time=start + middle, fit=fitted)


def open_reduced(mission: AnyMission, seed: int, *, ideal: bool = False) -> ReducedRig:
    """Open the reduced plant of a mission: an ``opener`` for `smolbot.flight.session.fly`.

    Parameters
    ----------
    mission : Mission or Observation
    seed : int
    ideal : bool
        Sample no mismatch.

    Returns
    -------
    ReducedRig

    Raises
    ------
    InputError
        As `require_flyable`.
    """
    require_flyable(mission)
    settings = mission.rig.section_of("tank", TankSettings)
    start = np.asarray(mission.start, dtype=np.float64)
    return ReducedRig(mission.rig, mission.robot, settings, start, seed, ideal=ideal)


def require_flyable(mission: AnyMission) -> None:
    """Check that the reduced plant can simulate a mission.

    Parameters
    ----------
    mission : Mission or Observation

    Raises
    ------
    InputError
        If the mission's rig is not a simulated tank, or its robot is of another kind.
    """
    robot = mission.robot
    kind: str = robot.kind
    if mission.rig.world != "tank":
        raise InputError(
            f"The reduced plant replaces a simulated tank; '{mission.rig.name}' is of world '{mission.rig.world}'."
        )
    if kind != "gradient" or not robot.device.along_cantilever:
        what = "has its moment across the cantilever" if kind == "gradient" else f"is of kind '{kind}'"
        raise InputError(
            "The reduced plant supports robots of kind 'gradient' with the moment along the cantilever; "
            f"'{robot.name}' {what}. Fly it in the full tank: --plant full."
        )
    if mission.rig.section_of("tank", TankSettings).faults:
        raise InputError("The reduced plant has no sensors or coils that could fail: fly faults with --plant full.")
