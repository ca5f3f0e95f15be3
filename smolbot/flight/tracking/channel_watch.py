"""Watch over the sensors in flight: one that disagrees with the others is left out until it agrees again.

A fit tells what each sensor should have measured. Where a sensor's signal differs by more than noise and the rig file's
tolerances explain, or where the pose cannot be, the fit is repeated without it. The pose counts if the remaining
sensors then agree with each other, and if it is one that the robot can have reached; otherwise it is not trusted.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from smolbot.core.arrays import BoolArray, FloatArray
from smolbot.core.pose import Pose
from smolbot.core.sensing import Recording
from smolbot.errors import SafetyError
from smolbot.flight.tracking.pose_gate import PoseGate
from smolbot.localization.array.consistency import ChannelCheck, compute_gain_sigmas
from smolbot.localization.array.terms import DEVIATIONS_OF_DEVICE, ArrayTerms
from smolbot.localization.estimator import Oscillation, PoseEstimator
from smolbot.localization.localizer import Localizer, Swing
from smolbot.localization.noise.model import NoiseModel
from smolbot.localization.problem import MIN_OUTPUTS, find_constant_channels

MIN_MISFIT_SIGMAS = 2.0
"""Standard deviations by which the residuals must exceed the noise for the sensors to be checked one by one."""

MIN_SIGMAS = 5.0
"""Standard deviations from which a sensor has failed: with ten sensors, noise does that once in 100 000 windows."""

MIN_RIVAL_SIGMAS = 3.0
"""Standard deviations from which a sensor is tried at all, and below which one that was left out agrees again."""

MAX_MEAN_SIGMAS = 1.5
"""Mean deviation, in standard deviations, up to which a sensor agrees again: about 0.9 where it works."""

MIN_RIVAL_SHARE = 0.7
"""Deviation of another sensor, relative to the largest, from which it may be the one that has failed."""

MIN_ODDS = 12.0
"""Chi-square by which leaving out another sensor must be worse if it gives another pose (odds of 400 to 1)."""

SAME_POSITION = 1e-3
"""Distance, in m, within which two poses lead to the same command."""

MAX_LEFT_OUT = 3
"""Number of sensors that one recording may lead to leave out."""

MIN_CHECKED = MIN_OUTPUTS + 1
"""Fewest sensors that can check each other."""

MAX_SIGMA = 0.7e-3
"""Standard deviation, in m, in the direction in which it is largest, up to which a pose from the remaining sensors is
trusted: of such poses, 99.6 % are less than 2 mm off there."""

MAX_POWER_RATIO = 100.0
"""Power of a sensor's residuals, relative to its noise, up to which it may only have become noisier."""

RETURN_WINDOWS, MAX_RETURN_WINDOWS = 20, 320
"""Windows in a row in which a sensor must agree before it is used again: at first, and at most. Each time that it fails
again, the number doubles."""

MEMORY = 0.95
"""Weight of the recordings so far when one is added to what is known of the gains: twenty count."""

GAIN_INTERVAL = 5
"""Recordings after which the gains are checked."""

CHANGED_MOMENT = 0.3
"""Standard deviation of the logarithm of the moment in a check of sensors: a device that changes in flight is heard by
all sensors alike, and is no reason to leave one out."""

_DISAGREES = "disagrees with the other sensors"


@dataclass
class _Doubt:
    """A sensor that is left out: windows in a row in which it must agree, and has, and its deviations in them."""

    needed: int
    agreed: int = 0
    sigmas: float = 0.0

    def add(self, sigmas: float) -> bool:
        """Add a window; return whether the sensor agrees again."""
        if not -np.inf < sigmas < MIN_RIVAL_SIGMAS:
            self.agreed, self.sigmas = 0, 0.0
            return False
        self.agreed, self.sigmas = self.agreed + 1, self.sigmas + sigmas
        if self.agreed < self.needed:
            return False
        if self.sigmas < MAX_MEAN_SIGMAS * self.agreed:
            return True
        self.agreed, self.sigmas = 0, 0.0
        return False


@dataclass(frozen=True)
class Located:
    """Result of one recording.

    Attributes
    ----------
    pose : Pose
    swing : Oscillation or None
    reason : str
        Why the pose is not trusted, where that is known.
    """

    pose: Pose
    swing: Oscillation | None
    reason: str = ""


@dataclass(frozen=True)
class _Attempt:
    """A fit without some sensors, and its check."""

    left_out: tuple[int, ...]
    pose: Pose
    swing: Swing
    check: ChannelCheck
    objection: str

    @property
    def consistent(self) -> bool:
        return not self.objection and bool(self.check.sigmas.max() < MIN_SIGMAS)


class ChannelWatch:
    """Locates with the sensors that agree with each other, and remembers those that do not.

    Parameters
    ----------
    gate : PoseGate
    frames : ndarray, shape (n_sensors, 2, 3)
        Directions of each sensor's tilts.
    covariance : ndarray, shape (6 * n_sensors + 2, 6 * n_sensors + 2), or None
        Of the deviations of sensors and device from what is assumed; None if sensors cannot check each other. While a
        hand guides the device, what holds it moves too, and its field at a single sensor resembles a failure.
    broken : collection of int
        Sensors, from 0, that are known to be broken: they are never used.
    may_leave_out : bool
        Whether a flight goes on without a sensor that has failed. If not, it ends.
    max_windows : int
        Windows in a row in which a sensor fails at which such a flight ends.

    Attributes
    ----------
    gate : PoseGate
    checks_signals : bool
        Whether the sensors check each other.
    """

    def __init__(
        self,
        gate: PoseGate,
        frames: FloatArray,
        covariance: FloatArray | None,
        broken: Collection[int] = (),
        *,
        may_leave_out: bool = True,
        max_windows: int = 5,
    ) -> None:
        self.gate = gate
        self._events: list[tuple[str, dict[str, object]]] = []
        self._frames = frames
        self.checks_signals = covariance is not None
        self._covariance = np.zeros((0, 0)) if covariance is None else _allow_changed_moment(covariance)
        self._may_leave_out = may_leave_out
        self._max_windows = max_windows
        n = len(frames)
        self._broken = np.array([i in broken for i in range(n)], dtype=np.bool_)
        self._doubts: dict[int, _Doubt] = {}
        self._needed = [RETURN_WINDOWS] * n
        self._silent = np.zeros(n, dtype=np.int64)  # windows in a row without a signal
        self._failing = 0  # windows in a row with a sensor that may not be left out
        self._information, self._right = np.zeros_like(self._covariance), np.zeros(len(self._covariance))
        self._added = 0

    @property
    def left_out(self) -> tuple[int, ...]:
        """Sensors, from 0, that are left out because they disagree with the others."""
        return tuple(sorted(self._doubts))

    def take_events(self) -> list[tuple[str, dict[str, object]]]:
        """Return what was decided since the last call.

        Returns
        -------
        list of tuple
            Name and details of each event.
        """
        events, self._events = self._events, []
        return events

    def locate(
        self, localizer: PoseEstimator, recording: Recording, prior: Pose | None, predicted: Pose | None
    ) -> Located:
        """Locate with the sensors that agree with each other.

        Parameters
        ----------
        localizer : PoseEstimator
        recording : Recording
        prior : Pose or None
            Start of the fit.
        predicted : Pose or None
            Tracked pose before the shot, if it can be relied on.

        Returns
        -------
        Located

        Raises
        ------
        InputError
            If too few sensors remain.
        SafetyError
            If a sensor fails that may not be left out.
        """
        self._note_silent_channels(recording)
        usable = _mask(recording, self._broken)
        masked = _mask(usable, self._as_mask(self._doubts))
        pose, swing = localizer.locate_swing(masked, prior)
        if not isinstance(pose, Pose) or not pose.trusted:
            suspicious = isinstance(pose, Pose) and _is_suspicious(swing)
            objection = ""
        else:
            objection = self.gate.find_objection(pose, predicted)
            suspicious = bool(objection) or prior is None or _is_suspicious(swing)
        found = Located(pose, swing)
        if (
            self.checks_signals
            and suspicious
            and isinstance(localizer, Localizer)
            and isinstance(swing, Swing)
            and swing.white
        ):
            found = self._check(localizer, masked, prior, predicted, (pose, swing, objection))
        elif objection:
            found = Located(replace(pose, trusted=False), swing, objection)
        if self._doubts and isinstance(localizer, Localizer) and found.pose.trusted:
            self._check_return(localizer, usable, found)
            sigma = math.sqrt(float(np.linalg.eigvalsh(found.pose.covariance[:3, :3])[-1]))
            if sigma > MAX_SIGMA:
                why = f"without sensors {self.left_out} the pose is known to {1e3 * sigma:.1f} mm only"
                return Located(replace(found.pose, trusted=False), found.swing, why)
        return found

    def _check(
        self,
        localizer: Localizer,
        recording: Recording,
        prior: Pose | None,
        predicted: Pose | None,
        first: tuple[Pose, Swing, str],
    ) -> Located:
        """Check a suspicious fit, and leave out the sensors without which the others agree."""
        pose, swing, objection = first
        check = swing.check_channels(self._frames, self._covariance)
        whole = _Attempt((), pose, swing, check, objection)
        if whole.consistent:
            self._failing = 0
            return Located(pose, swing)
        found = self._search(localizer, recording, prior, predicted, whole)
        if isinstance(found, str):
            return Located(replace(pose, trusted=False), swing, found)
        if not self._may_leave_out:
            return self._refuse(whole, found)
        for channel in found.left_out:
            self._leave_out(channel, float(check.sigmas[channel]))
        return Located(found.pose, found.swing)

    def _search(
        self, localizer: Localizer, recording: Recording, prior: Pose | None, predicted: Pose | None, whole: _Attempt
    ) -> _Attempt | str:
        """Search for the sensors to leave out; return why if there is no clear answer."""
        base, remaining = whole, int(np.isfinite(whole.check.sigmas).sum())
        while len(base.left_out) < MAX_LEFT_OUT and remaining - len(base.left_out) > MIN_CHECKED:
            sigmas = base.check.sigmas
            order = [int(j) for j in np.argsort(-sigmas) if sigmas[j] >= MIN_RIVAL_SIGMAS]
            attempts: list[_Attempt] = []
            for channel in order:
                clear = any(a.consistent for a in attempts)
                if clear and sigmas[channel] < MIN_RIVAL_SHARE * sigmas[order[0]]:
                    break
                attempts.append(self._try_without(localizer, recording, prior, predicted, (*base.left_out, channel)))
            good = [a for a in attempts if a.consistent and a.pose.trusted]
            if good:
                return _choose_attempt(good)
            if not attempts:
                break
            base = min(attempts, key=lambda a: a.check.total)
        return whole.objection or _describe_disagreement(whole.check)

    def _try_without(
        self,
        localizer: Localizer,
        recording: Recording,
        prior: Pose | None,
        predicted: Pose | None,
        left_out: tuple[int, ...],
    ) -> _Attempt:
        pose, swing = localizer.locate_swing(_mask(recording, self._as_mask(left_out)), prior)
        check = swing.check_channels(self._frames, self._covariance)
        return _Attempt(left_out, pose, swing, check, self.gate.find_objection(pose, predicted))

    def _refuse(self, whole: _Attempt, found: _Attempt) -> Located:
        """Do not trust a pose with a failed sensor that may not be left out, and end the flight if that goes on."""
        names = ", ".join(map(str, found.left_out))
        reason = (
            f"sensor{'s' if len(found.left_out) > 1 else ''} {names} (counted from 0) "
            f"{'disagree' if len(found.left_out) > 1 else 'disagrees'} with the others by "
            f"{whole.check.sigmas.max():.0f} standard deviations"
        )
        self._failing += 1
        if self._failing >= self._max_windows:
            raise SafetyError(
                f"In {self._failing} listening windows in a row, {reason} (sensor_shots = {self._max_windows}; "
                "may_leave_out_sensors is false).",
                value=float(self._failing),
                limit=float(self._max_windows),
                unit="windows",
                channel=names,
            )
        return Located(replace(whole.pose, trusted=False), whole.swing, reason)

    def add_terms(self, terms: ArrayTerms, applied: FloatArray) -> None:
        """Add what a recording tells on the sensors, and leave out one whose gain has changed slowly.

        Parameters
        ----------
        terms : ArrayTerms
        applied : ndarray, shape (6 * n_sensors + 2,)
            Deviations that the fit has taken into account.
        """
        if not self.checks_signals:
            return
        self._information = MEMORY * self._information + terms.information
        self._right = MEMORY * self._right + terms.right + terms.information @ applied
        self._added += 1
        if self._added % GAIN_INTERVAL:
            return
        sigmas = compute_gain_sigmas(self._information, self._right, self._covariance)
        second, first = np.sort(sigmas)[-2:]
        if first < MIN_SIGMAS or first**2 - second**2 < MIN_ODDS or not self._may_leave_out:
            return
        if int(np.isfinite(sigmas).sum()) - len(self._doubts) > MIN_CHECKED:
            self._leave_out(int(np.argmax(sigmas)), float(first))

    def compute_energies(
        self, localizer: PoseEstimator, recording: Recording, swing: Oscillation, noise: NoiseModel
    ) -> tuple[FloatArray, FloatArray] | None:
        """Compute the energy of each sensor's fit residuals, also of one that is left out and may only be noisier.

        Once its noise is known, such a sensor agrees with the others, and is used again.

        Parameters
        ----------
        localizer : PoseEstimator
        recording : Recording
        swing : Oscillation
            Found in the recording.
        noise : NoiseModel

        Returns
        -------
        tuple of ndarray, shape (n_sensors,), or None
            See `Oscillation.compute_energies`.
        """
        energies = swing.compute_energies(recording, noise)
        if energies is None or not self._doubts or not (isinstance(localizer, Localizer) and isinstance(swing, Swing)):
            return energies
        usable = _mask(recording, self._broken)
        problem = localizer.prepare(usable, localizer.free_trend(usable))
        everything = swing.compute_energies(usable, noise, problem)
        assert everything is not None
        for channel in self._doubts:
            if everything[0][channel] < MAX_POWER_RATIO * everything[1][channel]:
                energies[0][channel], energies[1][channel] = everything[0][channel], everything[1][channel]
        return energies

    def _leave_out(self, channel: int, sigmas: float) -> None:
        self._doubts[channel] = _Doubt(self._needed[channel])
        self._needed[channel] = min(2 * self._needed[channel], MAX_RETURN_WINDOWS)
        self._information[:], self._right[:] = 0.0, 0.0
        self._events.append(("sensor left out", {"sensor": channel, "why": _DISAGREES, "sigmas": round(sigmas, 1)}))

    def _check_return(self, localizer: Localizer, recording: Recording, found: Located) -> None:
        """Use a sensor again once it agrees with the others for long enough."""
        swing = found.swing
        assert isinstance(swing, Swing)
        for channel, doubt in tuple(self._doubts.items()):
            with_it = _mask(recording, self._as_mask([other for other in self._doubts if other != channel]))
            problem = localizer.prepare(with_it, localizer.free_trend(with_it))
            sigmas = swing.check_channels(self._frames, self._covariance, problem).sigmas
            if doubt.add(float(sigmas[channel])):
                del self._doubts[channel]
                self._events.append(("sensor used again", {"sensor": channel}))

    def _note_silent_channels(self, recording: Recording) -> None:
        """Note as an event which sensors begin and cease to give no signal."""
        silent = (find_constant_channels(recording.field) | recording.saturated) & ~self._broken
        was = self._silent >= self._max_windows
        self._silent[silent] += 1
        self._silent[~silent] = 0
        now = self._silent >= self._max_windows
        for channel in np.flatnonzero(now & ~was):
            why = "saturated" if recording.saturated[channel] else "constant (dead, or a broken wire)"
            self._events.append(("sensor left out", {"sensor": int(channel), "why": why}))
        for channel in np.flatnonzero(was & ~now):
            self._events.append(("sensor used again", {"sensor": int(channel)}))

    def _as_mask(self, channels: Collection[int]) -> BoolArray:
        mask = np.zeros(len(self._frames), dtype=np.bool_)
        mask[list(channels)] = True
        return mask


def _mask(recording: Recording, channels: BoolArray) -> Recording:
    """Return a recording in which some channels are not to be used."""
    return replace(recording, saturated=recording.saturated | channels) if channels.any() else recording


def _allow_changed_moment(covariance: FloatArray) -> FloatArray:
    """Return the covariance of deviations with a moment that may have changed."""
    at = -DEVIATIONS_OF_DEVICE
    changed = covariance.copy()
    changed[at, at] = max(changed[at, at], CHANGED_MOMENT**2)
    return changed


def _is_suspicious(swing: Oscillation | None) -> bool:
    """Return whether the residuals of a whitened fit are larger than noise alone makes them."""
    if not isinstance(swing, Swing) or not swing.white:
        return False
    return swing.misfit > 1.0 + MIN_MISFIT_SIGMAS * math.sqrt(2.0 / swing.degrees_of_freedom)


def _choose_attempt(good: list[_Attempt]) -> _Attempt | str:
    """Choose the fit that explains the data best; return why if another one does so as well, at another place."""
    good = sorted(good, key=lambda a: a.check.excess)
    best = good[0]
    for other in good[1:]:
        far = float(np.linalg.norm(other.pose.position - best.pose.position)) > SAME_POSITION
        if far and other.check.excess - best.check.excess < MIN_ODDS:
            return (
                f"sensor {best.left_out[-1]} or {other.left_out[-1]} (counted from 0) disagrees with the others; "
                "which of them is not clear"
            )
    return best


def _describe_disagreement(check: ChannelCheck) -> str:
    worst = [int(j) for j in np.argsort(-check.sigmas) if check.sigmas[j] >= MIN_SIGMAS]
    if not worst:
        return "the sensors do not agree on one pose"
    shown = ", ".join(f"{j} ({check.sigmas[j]:.0f})" for j in worst[:3])
    return f"the sensors disagree, most of all (standard deviations): {shown}"
