"""The rotating magnet on its stage: mechanical shots, with an operator who brings it near and takes it away."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from smolbot.bench.hardware.wiring import OperatorSection, StageSection
from smolbot.config.rig_sections import MagnetSection
from smolbot.core.rig import CheckItem
from smolbot.core.shots import MoveMagnet, Rest, Rotate, Shot
from smolbot.errors import RigError

if TYPE_CHECKING:
    from smolbot.core.operator import Operator

POLL_INTERVAL = 0.05
"""Seconds between two checks of the switches, or of whether to stop."""

MOVE_MARGIN = 2.0
"""Seconds that a move may take longer than planned, because of its ramps."""


class Magnet:
    """Plays mechanical shots.

    Parameters
    ----------
    magnet : MagnetSection
    section : StageSection
    operator_section : OperatorSection
        How long to wait for the operator.
    operator : Operator

    Attributes
    ----------
    near : bool
        Where the magnet is, as far as is known.
    has_switches : bool
        Whether switches at the stage detect where it is.
    identity : str
        Name and version of the firmware.

    Raises
    ------
    RigError
        If the stage cannot be opened, or the magnet is not away.
    """

    def __init__(
        self, magnet: MagnetSection, section: StageSection, operator_section: OperatorSection, operator: Operator
    ) -> None:
        from smolbot.bench.hardware.stage import MagnetStage

        self._operator, self._answer_timeout = operator, operator_section.answer_timeout_s
        self._steering_rate = magnet.max_steering_rate
        self.has_switches = section.switches
        self._stage = MagnetStage(section, self._steering_rate)
        self._stage.open()
        try:
            self.identity = str(self._stage.identity)
            self.near = self.has_switches and self._stage.place != "away"
            if self.near:
                raise RigError(
                    f"the magnet is not away (its switches say {self._stage.place or 'neither near nor away'}); "
                    "take it away before a mission.",
                    device="magnet stage",
                )
            self._stage.arm()
        except BaseException:
            self._stage.close()
            raise

    def play(self, shot: Shot, proceed: Callable[[], None]) -> None:
        """Play a mechanical shot.

        Parameters
        ----------
        shot : Shot
        proceed : callable
            Called again and again; raises if the shot is to end.

        Raises
        ------
        RigError
            If the stage fails, the operator aborts, or the magnet is not moved in time.
        """
        for number, window in enumerate(shot.windows):
            proceed()
            if isinstance(window, MoveMagnet):
                if window.to == "near":
                    self._steer_ahead(shot, number, proceed)
                self._move(window, proceed)
            elif isinstance(window, Rotate):
                self._stage.turn(math.atan2(window.axis[1], window.axis[0]), window.turns, window.frequency)
                self._wait_until_idle(window.duration + 0.5 * math.pi / self._steering_rate + MOVE_MARGIN, proceed)
            elif isinstance(window, Rest):
                self._pause(window.duration, proceed)

    def _steer_ahead(self, shot: Shot, number: int, proceed: Callable[[], None]) -> None:
        """Steer to the axis of the first turn while the magnet is away, so that it does not move the robot."""
        first = next((w for w in shot.windows[number:] if isinstance(w, Rotate)), None)
        if first is not None and not self.near:
            self._stage.steer(math.atan2(first.axis[1], first.axis[0]))
            self._wait_until_idle(math.pi / self._steering_rate + MOVE_MARGIN, proceed)

    def _move(self, window: MoveMagnet, proceed: Callable[[], None]) -> None:
        if self._get_place() == window.to:
            return
        request = f"Bring the magnet {'near' if window.to == 'near' else 'away'}"
        if not self.has_switches:
            if not self._operator.ask(f"{request}.", self._answer_timeout):
                raise RigError(f"Stopped by the operator, who was asked to bring the magnet {window.to}.")
            self.near = window.to == "near"
            return
        self.near = True  # on its way it may be anywhere
        self._stage.set_lamp(window.to)
        self._operator.say(f"{request}; its switch is waited for, {self._answer_timeout:g} s at most.")
        end = time.monotonic() + self._answer_timeout
        try:
            while self._get_place() != window.to:
                proceed()
                if time.monotonic() > end:
                    raise RigError(
                        f"The magnet was not brought {window.to} within {self._answer_timeout:g} s "
                        f"(its switches say {self._get_place() or 'neither near nor away'})."
                    )
                time.sleep(POLL_INTERVAL)
        finally:
            self._stage.set_lamp(None)
        self.near = window.to == "near"

    def _get_place(self) -> str | None:
        return self._stage.place if self.has_switches else ("near" if self.near else "away")

    def _wait_until_idle(self, longest: float, proceed: Callable[[], None]) -> None:
        end = time.monotonic() + longest
        while not self._stage.wait(POLL_INTERVAL):
            proceed()
            if time.monotonic() > end:
                self._stage.stop()
                raise RigError(
                    f"The magnet stage did not come to rest within {longest:.1f} s; its motors are off.",
                    device="magnet stage",
                )

    @staticmethod
    def _pause(duration: float, proceed: Callable[[], None]) -> None:
        end = time.monotonic() + duration
        while (left := end - time.monotonic()) > 0.0:
            proceed()
            time.sleep(min(left, POLL_INTERVAL))

    def checks(self) -> Iterator[CheckItem]:
        """Read firmware and switches; nothing moves.

        Yields
        ------
        CheckItem
        """
        yield CheckItem("magnet stage", "firmware", self.identity)
        if self.has_switches:
            place = self._stage.place or "neither near nor away"
            yield CheckItem("magnet stage", "magnet", place, place == "away", "away")

    def check_at_rest(self) -> None:
        """Check that the motors stand still and the firmware reports no fault.

        Raises
        ------
        RigError
            If a motor turns, or the stage has failed.
        """
        self._stage.check_at_rest()

    def take_recovered(self) -> Counter[str]:
        """Return, and reset, the count of errors of the serial line that were recovered from.

        Returns
        -------
        Counter
            Since the last call, by name.
        """
        return self._stage.take_recovered()

    def stop(self) -> None:
        """Stop the motors now. Safe from any thread."""
        self._stage.stop()

    def close(self) -> None:
        """Stop the motors, then close the port."""
        self._stage.close()
