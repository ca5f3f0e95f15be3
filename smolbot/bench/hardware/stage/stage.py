"""The magnet stage in SI units: steering of its axis, turns of its magnet, and a reliable stop."""

from __future__ import annotations

import math
import threading
import time
from collections import Counter
from dataclasses import replace

from smolbot.bench.hardware.stage.link import Link
from smolbot.bench.hardware.stage.ports import open_link
from smolbot.bench.hardware.stage.protocol import (
    RATE_MAX,
    RATE_MIN,
    STEPS_MAX,
    GarbledError,
    Place,
    StageState,
    parse_state,
)
from smolbot.bench.hardware.wiring import StageSection
from smolbot.errors import RigError

HEARTBEAT_INTERVAL = 0.1
"""Seconds between two heartbeats. The firmware switches the motors off after 0.5 s without one."""

DEFAULT_STEERING_RATE = math.radians(10.0)
"""Default steering rate, in rad/s."""


class MagnetStage:
    """Motor that turns the magnet, and motor that steers the axis of the turns, behind a serial port.

    Steering is counted from the axis at power-up of the board: heading 0, pole down. A thread sends the firmware's
    heartbeat from `open` to `close`; an error that it finds is raised by the next call.

    Parameters
    ----------
    section : StageSection
    steering_rate : float, in rad/s
        Speed at which the axis is steered.

    Raises
    ------
    RigError
        From every method but `stop` and `close`, with port, action and cause. The motors are off then, or go off
        within a second.
    """

    def __init__(self, section: StageSection, steering_rate: float = DEFAULT_STEERING_RATE) -> None:
        self._section, self._steering_rate = section, steering_rate
        self._link: Link | None = None
        self._state: StageState | None = None
        self._failure: RigError | None = None
        self._armed = False
        self._news = threading.Condition()
        self._sending = threading.Lock()  # held until an answer is known: an older one never overwrites a newer
        self._ending = threading.Event()
        self._heart: threading.Thread | None = None

    @property
    def identity(self) -> str:
        """Name and version of the firmware."""
        return self._open_link().identity

    @property
    def place(self) -> Place | None:
        """Which end switch the magnet closes; None if neither or both are closed."""
        return self._get_state().at

    def open(self) -> None:
        """Find and open the port, wait for the firmware, start the heartbeat. The motors stay off.

        A fault that an earlier run left behind is cleared, since that run has reported it.
        """
        self._link = open_link(self._section.port, self._section.baud)
        try:
            self._link.exchange("OFF", "switching the motors off")
            self._link.exchange("CLEAR", "clearing what an earlier run left")
            self._send_heartbeat()
        except BaseException:
            self._link.close()
            self._link = None
            raise
        self._heart = threading.Thread(target=self._keep_heartbeat, name="magnet stage heartbeat", daemon=True)
        self._heart.start()

    def arm(self) -> None:
        """Power the motors; they hold their position."""
        self._get_state()
        self._command("ARM", "arming the motors")
        with self._news:
            self._armed = True
        self._send_heartbeat_or_fail()  # reads the position of the axis

    def turn(self, heading: float, turns: float, frequency: float) -> None:
        """Steer the axis and turn the magnet about it. Return at once.

        The axis goes to the opposite heading if that is nearer, and the magnet then turns the other way.

        Parameters
        ----------
        heading : float, in rad
            Of the axis, from where it was at power-up.
        turns : float
            Number of turns; the sign is their direction.
        frequency : float, in Hz
            Turns per second.
        """
        steering, backward = self._choose_nearer_axis(heading)
        count = (-1 if backward else 1) * round(turns * self._section.steps_per_turn)
        self._move(count, abs(frequency) * self._section.steps_per_turn, steering, "turning the magnet")

    def steer(self, heading: float) -> None:
        """Steer the axis to a heading or its opposite, whichever is nearer. Return at once.

        Parameters
        ----------
        heading : float, in rad
            From where the axis was at power-up.
        """
        self._move(0, 0.0, self._choose_nearer_axis(heading)[0], "steering the axis")

    def wait(self, seconds: float) -> bool:
        """Wait until both motors stand still.

        Parameters
        ----------
        seconds : float, in s
            Longest time to wait.

        Returns
        -------
        bool
            Whether they stand still.
        """
        end = time.monotonic() + seconds
        with self._news:
            while self._get_state_locked().moving:
                left = end - time.monotonic()
                if left <= 0.0:
                    return False
                self._news.wait(left)
        return True

    def set_lamp(self, place: Place | None) -> None:
        """Light the lamp that asks the operator to bring the magnet near or away.

        Parameters
        ----------
        place : {"near", "away"} or None
            None for no lamp.
        """
        self._command(f"LAMP {(place or 'none').upper()}", "setting the operator's lamp")

    def check_at_rest(self) -> None:
        """Check that the motors stand still and nothing has failed.

        Raises
        ------
        RigError
            Otherwise.
        """
        if self._get_state().moving:
            raise self._open_link().make_error("checking that the magnet rests", "its motors turn")

    def take_recovered(self) -> Counter[str]:
        """Return, and reset, the count of errors of the serial line that were recovered from.

        Returns
        -------
        Counter
            Since the last call, by name.
        """
        return Counter({f"magnet stage: {name}": n for name, n in self._open_link().take_recovered().items()})

    def stop(self) -> None:
        """Switch the motors off now. Safe from any thread; raises nothing.

        If the line is lost, the heartbeat ends, and the firmware switches them off by itself within 0.5 s.
        """
        with self._news:
            self._armed = False
        if self._link is None or self._ending.is_set():
            return
        try:
            with self._sending:
                self._link.exchange("OFF", "switching the motors off")
                with self._news:
                    if self._state is not None:
                        self._state = replace(self._state, armed=False, moving=False)
                    self._news.notify_all()
        except RigError as error:
            self._fail(error)

    def close(self) -> None:
        """Switch motors and lamps off and close the port. May be called twice."""
        link = self._link
        if link is None:
            return
        self.stop()
        self._ending.set()
        if self._heart is not None:
            self._heart.join()
        if self._failure is None:
            try:
                link.exchange("LAMP NONE", "switching the operator's lamp off")
            except RigError as error:
                self._fail(error)
        link.close()
        self._link = None

    def _open_link(self) -> Link:
        if self._link is None:
            raise RigError("magnet stage: not open.", device="magnet stage")
        return self._link

    def _get_state(self) -> StageState:
        with self._news:
            return self._get_state_locked()

    def _get_state_locked(self) -> StageState:
        self._open_link()
        if self._failure is not None:
            raise RigError(str(self._failure), device="magnet stage") from self._failure
        assert self._state is not None
        return self._state

    def _command(self, command: str, action: str) -> None:
        self._get_state()
        try:
            self._open_link().exchange(command, action)
        except RigError as error:
            self._fail(error)
            raise

    def _choose_nearer_axis(self, heading: float) -> tuple[int, bool]:
        """Compute the steps to a heading or its opposite, whichever is nearer, and whether it is the opposite."""
        per_turn = self._section.steering_steps_per_turn
        now = self._get_state().steering
        off = _wrap_angle(heading - 2.0 * math.pi * now / per_turn)
        backward = abs(off) > 0.5 * math.pi
        off = _wrap_angle(off + math.pi) if backward else off
        return round(off * per_turn / (2.0 * math.pi)), backward

    def _move(self, turn: int, turn_rate: float, steering: int, action: str) -> None:
        if turn and not RATE_MIN <= round(turn_rate) <= RATE_MAX:
            raise self._open_link().make_error(
                action, f"needs {turn_rate:.0f} steps a second; the firmware steps {RATE_MIN} to {RATE_MAX}"
            )
        if max(abs(turn), abs(steering)) > STEPS_MAX:
            raise self._open_link().make_error(
                action, f"needs more than the {STEPS_MAX} steps the firmware makes at once"
            )
        steering_rate = self._steering_rate * self._section.steering_steps_per_turn / (2.0 * math.pi)
        rates = round(turn_rate) if turn else 0, round(min(max(steering_rate, RATE_MIN), RATE_MAX)) if steering else 0
        with self._news:
            armed = self._armed
        if not armed:
            raise self._open_link().make_error(action, "the motors are off")
        if turn or steering:
            self._command(f"MOVE {turn} {rates[0]} {steering} {rates[1]}", action)
            self._send_heartbeat_or_fail()

    def _send_heartbeat(self) -> None:
        """Send one heartbeat, and store the state that it returns."""
        link = self._open_link()
        with self._sending:
            with self._news:
                armed = self._armed
            try:
                state = parse_state(link.exchange("BEAT", "heartbeat"))
            except GarbledError as error:
                raise link.make_error("heartbeat", str(error)) from error
            with self._news:
                self._state = state
                still_armed = armed and self._armed
                self._news.notify_all()
        if state.fault != "NONE" or (still_armed and not state.armed):
            raise link.make_error("heartbeat", f"the firmware has switched its motors off (fault: {state.fault})")

    def _send_heartbeat_or_fail(self) -> None:
        try:
            self._send_heartbeat()
        except RigError as error:
            self._fail(error)
            raise

    def _keep_heartbeat(self) -> None:
        while not self._ending.wait(HEARTBEAT_INTERVAL):
            try:
                self._send_heartbeat()
            except RigError as error:
                self._fail(error)
                return

    def _fail(self, error: RigError) -> None:
        """End the heartbeat, so that the firmware stops the motors even if no command gets through."""
        with self._news:
            self._failure = self._failure or error
            self._armed = False
            if self._state is not None:
                self._state = replace(self._state, armed=False)
            self._news.notify_all()
        self._ending.set()


def _wrap_angle(angle: float) -> float:
    """Wrap an angle to within half a turn of zero."""
    return math.remainder(angle, 2.0 * math.pi)
