"""One complete twin: plant, card, device server, truth, control, and the magnet stage if the rig has one."""

from __future__ import annotations

import functools
import gc
import math
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sim.tank.settings import TankSettings
from sim.twin.cardmodel import CardModel
from sim.twin.control import ControlServer
from sim.twin.deviceserver import DeviceServer
from sim.twin.faults import Fault, parse_fault
from sim.twin.hand import Hand
from sim.twin.plant import Plant
from sim.twin.supply import SupplyServer
from sim.twin.truth import TruthServer
from smolbot.bench.hardware.wiring import BenchSection, StageSection
from smolbot.config.rig import RigConfig
from smolbot.config.robot import RobotConfig
from smolbot.errors import InputError

if TYPE_CHECKING:
    from sim.twin.uno import SimulatedUno
    from smolbot.core.arrays import FloatArray

CONTROL = "127.0.0.1:31765"

LOOK = 0.02
"""Time, in s, between two checks whether a fault is over."""

SWITCH = 5e-4
"""Time, in s, after which a thread yields to another: readers and the card's thread must not wait for each other."""

STREAM = 5
"""Random stream of a seed for the operator's delays; the tank uses 0 to 4."""

CLEAR_TIMEOUT = 2.0
"""Longest time, in s, for the stage to reset after its faults are cleared."""

WARM_UP = (500, 250)
"""Samples that are played and read at first, so that all kernels are compiled."""

FOR_GOOD = 1_000_000
"""Lines of the serial port for which a permanent fault lasts: more than any mission sends."""

SERIAL_FAULTS = ("serial_unplugged", "serial_garbled", "serial_truncated", "firmware_reset", "firmware_hung")


class Twin:
    """A simulated bench that runs until it is closed.

    Parameters
    ----------
    rig : RigConfig
        With ``world = "bench"`` and addresses of this machine.
    robot : RobotConfig
    start : array_like, shape (2,), in m
        Requested start position (x, y), world frame.
    seed : int
        Of the tank's mismatches and noise.
    control : str
        Address of the control interface; port 0 takes a free one.

    Raises
    ------
    InputError
        If the rig file describes no twin.
    RigError
        If a port is taken.
    """

    def __init__(
        self, rig: RigConfig, robot: RobotConfig, start: FloatArray, seed: int, *, control: str = CONTROL
    ) -> None:
        section, settings = rig.section_of("bench", BenchSection), rig.section_of("tank", TankSettings)
        if not section.server or not section.truth:
            raise InputError(f"'{rig.name}' names no bench.server and bench.truth to listen on; use --rig twin.")
        self.section = section
        self.plant = Plant(rig, robot, settings, np.asarray(start, dtype=np.float64), seed)
        self._warm_up()
        self.card = CardModel(section, self.plant, self._between)
        self.card.faults.add_listener(self._fault)
        drawn = {"seed": seed, "ideal": settings.mismatch.scale == 0.0, **self.plant.drawn()}
        own = np.random.default_rng([seed, STREAM])
        self._hand = Hand(rig.magnet.move_s, settings.lateness, own) if section.stage else None
        self._told = -math.inf
        self._seen = 0
        self._latest: dict[str, dict[str, Any]] = {}
        self._closing: list[Any] = []
        self.stage: SimulatedUno | None = None
        try:
            self.truth = TruthServer(*_split(section.truth), drawn)
            self._closing.append(self.truth)
            host, port = _split(control)
            handlers = {
                "inject": self._inject,
                "clear": self._clear,
                "log": self._log,
                "state": self._state,
            }
            self.control = ControlServer(host, port, handlers)
            self._closing.append(self.control)
            self.server = DeviceServer(self.card, section.server)
            self._closing.append(self.server)
            if section.stage is not None:
                self._open_stage(section.stage)
            if section.supply is not None:
                self._closing.append(SupplyServer(int(section.supply.address.split("::")[2])))
        except BaseException:
            self.close()
            raise
        sys.setswitchinterval(SWITCH)
        gc.collect()
        gc.freeze()  # garbage collection of all imports would stop the card's thread for 0.1 s
        self.card.start()

    def _warm_up(self) -> None:
        """Compile the kernels, so that the card's thread need not wait for them."""
        self.plant.advance(np.zeros((len(self.plant.loads), WARM_UP[0])))
        self.plant.begin_acquisition()
        self.plant.volts(0, WARM_UP[1])

    def _open_stage(self, section: StageSection) -> None:
        from sim.twin.uno import SimulatedUno

        self._per_turn = (2 * math.pi / section.steps_per_turn, 2 * math.pi / section.steering_steps_per_turn)
        self.stage = SimulatedUno()
        self.stage.start(Path(section.port))
        self._closing.append(self.stage)

    def _between(self, until: float) -> None:
        """Move the magnet with the stage and publish the truth, before the tank plays to `until` s.

        Runs in the card's thread.
        """
        if self.stage is not None and self._hand is not None:
            hand = self._hand
            hand.look(self.stage.lamp, until)
            self.stage.set_switches(hand.place == "near", hand.place == "away")
            turn, steering = self.stage.steps
            near = None if hand.place is None else hand.place == "near"
            self.plant.magnet(turn * self._per_turn[0], steering * self._per_turn[1], near)
            self._write_down("motors", on=self.stage.enabled)
            self._write_down("magnet", place=hand.place or "on its way")
        times, poses = self.plant.history.since(self._told)
        new = times > self._told
        if new.any():
            self._told = float(times[-1])
            at = self.card.time_of(0) + times[new]
            self.truth.publish(np.column_stack([at, poses[new]]))

    def _write_down(self, what: str, **detail: Any) -> None:
        """Add an entry to the card's journal, if it has changed."""
        if self._latest.get(what) != detail:
            self._latest[what] = detail
            self.card.journal.note(what, **detail)

    def _fault(self, name: str) -> None:
        if name == "killed":
            self.server.kill()
            while self.card.faults.holds(name):
                time.sleep(LOOK)
            self.server.revive()
        elif name in SERIAL_FAULTS and self.stage is not None:
            stage, lines = self.stage, FOR_GOOD if self.card.faults.lasts(name) else 1
            actions: dict[str, Callable[[], None]] = {
                "serial_unplugged": stage.unplug,
                "serial_garbled": functools.partial(stage.garble, lines),
                "serial_truncated": functools.partial(stage.truncate, lines),
                "firmware_reset": stage.reset,
                "firmware_hung": stage.hang,
            }
            actions[name]()

    def inject(self, fault: Fault) -> None:
        """Inject a fault.

        Parameters
        ----------
        fault : Fault
        """
        self.card.faults.add(fault)

    def _inject(self, asked: Mapping[str, Any]) -> str:
        self.inject(parse_fault(str(asked["fault"])))
        return "waits"

    def _log(self, asked: Mapping[str, Any]) -> list[dict[str, Any]]:
        return self.card.journal.since(int(asked.get("since", 0)))

    def _clear(self, _: Mapping[str, Any]) -> str:
        self.card.faults.clear()
        if self.stage is not None and self._hand is not None:
            self.stage.plug()
            self.stage.garble(0)
            self.stage.truncate(0)
            self.stage.reset()
            end = time.monotonic() + CLEAR_TIMEOUT
            while self.stage.lamp is not None and time.monotonic() < end:
                time.sleep(LOOK)
            self._hand.put_away()
            self.stage.set_to_mark()
        return "cleared"

    def _state(self, _: Mapping[str, Any]) -> dict[str, Any]:
        found = dict(self.card.state()) | {"now": time.monotonic()}
        if self.stage is not None:
            turn, steering = self.stage.steps
            found |= {"motors_on": self.stage.enabled, "steps": [turn, steering], "lamp": self.stage.lamp}
            found["turning"], self._seen = turn != self._seen, turn
        return found

    def close(self) -> None:
        """Stop everything and release all resources; harmless when repeated."""
        self.card.faults.clear()
        self.card.close()
        while self._closing:
            self._closing.pop().close()
        self.plant.carrier.close()


def _split(address: str) -> tuple[str, int]:
    host, _, port = address.rpartition(":")
    if not host or not port.isdigit():
        raise InputError(f"'{address}' is no address; use host:port, such as 127.0.0.1:31763.")
    return host, int(port)
