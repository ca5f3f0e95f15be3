"""Planning of shots: actuation interleaved with localization, search for a lost signal, and pauses.

Where a magnet must approach and retract, actuation is a separate shot.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Protocol

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.drive import compute_drive
from smolbot.core.limits import Limits
from smolbot.core.pose import Pose
from smolbot.core.sensing import Device
from smolbot.core.shots import Actuate, Excite, Listen, Mode, RingDown, Shot, Window
from smolbot.flight.device_belief import DeviceBelief
from smolbot.localization.forward import compute_envelope
from smolbot.motion.controller import Command, Cycle

MAX_NOISE_DURATION = 1.0
"""Length, in s, of one recording of the background noise."""

PROBE_FREQUENCY_RATIO, MIN_PROBE_RING_DOWN = 1.37, 1e-3
"""Frequency of the excitation that a probe records, relative to the resonance, and its shortest ring-down in s: off
resonance the device hardly swings, so that the coils' decay is recorded alone."""

MAX_BURST_DOUBLINGS = 4
"""Number of times that the excitation is doubled in length while no signal is found."""

PROBE_HALF_PERIODS = 8
"""Length, in half-periods, of the recordings from which the coils' ring-down is learned."""

TAIL_CURRENTS = (0.025, 0.006, 0.0015)
"""Currents, as shares of the highest one, with which the decay of a coil is measured: the next lower one is used if
sensors were saturated. None of them moves a robot by more than some micrometres."""

TAIL_PULL_DURATION = 15e-3
"""Length of such an actuation window, in s."""

TAIL_PAUSE_DURATION = 8e-3
"""Time from its end to listening, in s."""

MIN_REMAINING_SWING = 0.2
"""Remaining swing, as a share of the stops, above which it is taken into account in the next burst. A device in a
capsule swings on for a second, and a burst against that swing would cancel most of both; with strong damping
nothing remains."""

SEARCH_DIRECTIONS = ((1.0, 0.0), (0.0, 1.0), (0.7, 0.7), (0.7, -0.7))
"""Excitation mixes (x, y) tried in turn while the orientation is unknown."""


def compute_actuation_time(turn_angle: float, t_min: float, t_max: float, sharp_angle: float) -> float:
    """Compute the actuation time for a turn: longer for sharp turns, so that the magnet aligns.

        t = t_min + (t_max - t_min) |turn| / pi    for |turn| > sharp, else t_min    (Eq. S17)

    Parameters
    ----------
    turn_angle : float, in rad
    t_min : float, in s
    t_max : float, in s
        Time for a turn of 180 degrees.
    sharp_angle : float, in rad
        Angle above which a turn counts as sharp.

    Returns
    -------
    float, in s

    Examples
    --------
    >>> [round(compute_actuation_time(np.radians(a), 0.03, 0.08, np.radians(30)), 4) for a in (0, 29, 90, 180)]
    [0.03, 0.03, 0.055, 0.08]
    """
    if abs(turn_angle) <= sharp_angle:
        return t_min
    return t_min + (t_max - t_min) * abs(float(turn_angle)) / math.pi


class TrackedPose(Protocol):
    """Protocol of the tracker as the scheduler uses it."""

    @property
    def pose(self) -> Pose | None:
        """The tracked pose; None before the first."""

    @property
    def misses(self) -> int:
        """Number of listening shots in a row without an accepted pose."""

    @property
    def confirmed(self) -> bool:
        """True once two poses have agreed."""

    def pose_at(self, time: float) -> Pose:
        """Predict the tracked pose.

        Parameters
        ----------
        time : float, in s
            On the rig's clock.

        Returns
        -------
        Pose
        """


class Scheduler:
    """Decides the mode of the next shot and lays out its windows.

    Modes: ``search`` without a pose; ``hold`` to listen without actuating, in a pause and after a lost window;
    ``track`` to actuate and listen; ``lost`` after `max_misses` windows without a trusted pose.

    Parameters
    ----------
    cycle : Cycle
    limits : Limits
    belief : DeviceBelief
        The assumed device; shots are made for its `scheduled`.
    excitation_field : callable
        Converts a position (3,) in m to the assumed field (2, 3) of the excitation coils in T per A.
    clock : callable
        Earliest start of the next shot, in s.
    max_misses : int
        Number of misses in a row at which actuation stops.

    Attributes
    ----------
    paused : bool
        Whether to listen without actuating, because somebody asked for it.
    blind : bool
        Whether the last window was lost. Until windows come again, the robot is not driven, and its last pose is kept:
        nothing says that it moved, and a search would hear as little.
    """

    def __init__(
        self,
        cycle: Cycle,
        limits: Limits,
        belief: DeviceBelief,
        excitation_field: Callable[[FloatArray], FloatArray],
        clock: Callable[[], float],
        max_misses: int = 3,
    ) -> None:
        self.cycle = cycle
        self.limits = limits
        self.belief = belief
        self.max_misses = max_misses
        self.paused = False
        self.blind = False
        self.search_shots = 0
        self._excitation_field = excitation_field
        self._clock = clock
        self._driven: float | None = None  # end of the last burst, in s

    @property
    def device(self) -> Device:
        """The device that shots are made for."""
        return self.belief.scheduled

    def make_noise_shots(self, duration: float) -> Iterator[Shot]:
        """Make shots of at most a second that only listen, to record background noise.

        Parameters
        ----------
        duration : float, in s
            Of all shots together.

        Yields
        ------
        Shot
        """
        frequency = self.device.frequency
        longest = min(MAX_NOISE_DURATION, self.limits.max_listen)
        count = max(round(duration / longest), 1)
        half_periods = max(int(2.0 * frequency * min(duration / count, longest)), 1)
        for _ in range(count):
            yield Shot((Listen(half_periods, frequency),), "quiet", self._clock())

    def make_probe_shots(self) -> Iterator[Shot]:
        """Make one shot for each excitation coil that excites off resonance and listens as early as the limits allow.

        Yields
        ------
        Shot
        """
        frequency = PROBE_FREQUENCY_RATIO * self.device.frequency
        ring_down = max(self.limits.min_ring_down, MIN_PROBE_RING_DOWN)
        for currents in ((self.cycle.excite_current, 0.0), (0.0, self.cycle.excite_current)):
            excite = Excite(currents, frequency, self.cycle.excite_cycles)
            listen = Listen(PROBE_HALF_PERIODS, self.device.frequency)
            yield Shot((excite, RingDown(ring_down), listen), "quiet", self._clock())

    def make_tail_shots(self, coil: int) -> Iterator[Shot]:
        """Make weak pulls of one actuation coil, each weaker than the last, until the sensors are not saturated.

        Parameters
        ----------
        coil : int
            Index of the coil, from 0.

        Yields
        ------
        Shot
        """
        for share in TAIL_CURRENTS:
            currents = [0.0] * len(self.limits.coils)
            currents[coil] = share * self.limits.max_current
            pull = Actuate(tuple(currents), min(TAIL_PULL_DURATION, self.limits.max_actuation))
            ring_down = RingDown(max(self.limits.min_ring_down, TAIL_PAUSE_DURATION))
            yield Shot((pull, ring_down, Listen(PROBE_HALF_PERIODS, self.device.frequency)), "quiet", self._clock())

    def next(self, command: Command, tracker: TrackedPose) -> Shot:
        """Plan the next shot from a command and the tracked pose.

        Parameters
        ----------
        command : Command
        tracker : TrackedPose

        Returns
        -------
        Shot
        """
        mode = self._choose_mode(tracker)
        windows: list[Window] = []
        if mode == "track" and command.mechanical:
            return Shot(command.mechanical, mode, self._clock())
        if mode == "track" and isinstance(command.window, Actuate):
            windows.append(command.window)
        self.search_shots = self.search_shots + 1 if mode in ("search", "lost") else 0
        start = self._clock() + sum(window.duration for window in windows)
        excite = self._plan_excitation(mode, None if tracker.pose is None else tracker.pose_at(start), start)
        self._driven = start + excite.duration
        windows.append(excite)
        windows.append(RingDown(self.cycle.ring_down))
        windows.append(Listen(self.cycle.half_periods, self.device.frequency))
        return Shot(tuple(windows), mode, self._clock())

    def _choose_mode(self, tracker: TrackedPose) -> Mode:
        if tracker.pose is None:
            return "search"
        if self.blind:
            return "hold"
        if tracker.misses >= self.max_misses:
            return "lost"
        return "hold" if self.paused or not tracker.confirmed else "track"

    def _plan_excitation(self, mode: Mode, pose: Pose | None, start: float) -> Excite:
        """Plan the excitation for the pose predicted for `start` s.

        In a search, each direction is tried in turn, with longer bursts from round to round.
        """
        turn = (self.search_shots - 1) % (len(SEARCH_DIRECTIONS) + 1) if mode in ("search", "lost") else 0
        rounds = max(self.search_shots - 1, 0) // (len(SEARCH_DIRECTIONS) + 1)
        if mode == "search":
            turn = (self.search_shots - 1) % len(SEARCH_DIRECTIONS) + 1
            rounds = max(self.search_shots - 1, 0) // len(SEARCH_DIRECTIONS)
        longest = int(self.limits.max_excitation * self.device.frequency)
        cycles = (
            min(self.cycle.excite_cycles * 2 ** min(rounds, MAX_BURST_DOUBLINGS), longest)
            if rounds
            else self.cycle.excite_cycles
        )
        most = self.cycle.excite_current
        if turn == 0 and pose is not None:
            fields = self._excitation_field(np.asarray(pose.position))
            currents = compute_drive(
                fields, pose, self.device, self.belief.inertia, cycles, most, self._compute_remaining_swing(start)
            ).currents
        else:
            currents = most * np.array(SEARCH_DIRECTIONS[turn - 1])
        return Excite((float(currents[0]), float(currents[1])), self.device.frequency, cycles)

    def _compute_remaining_swing(self, start: float) -> float:
        """Compute the remaining swing at `start` s as a share of the amplitude at the stops; 0 if negligible."""
        if self._driven is None:
            return 0.0
        left = float(compute_envelope(self.device, np.array([max(start - self._driven, 0.0)]))[0])
        return left if left > MIN_REMAINING_SWING else 0.0
