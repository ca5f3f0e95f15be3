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

from sim.tank.faults import InjectedFault
from sim.tank.settings import TankSettings
from sim.twin.card_model import CardModel
from sim.twin.control import ControlServer
from sim.twin.device_server import DeviceServer
from sim.twin.faults import parse_fault
from sim.twin.magnet_operator import MagnetOperator
from sim.twin.supply_model import SupplyServer
from sim.twin.truth_server import TruthServer
from sim.twin.twin_plant import TwinPlant
from smolbot.bench.hardware.wiring import BenchSection, StageSection
from smolbot.config.rig import RigConfig
from smolbot.config.robot import RobotConfig
from smolbot.errors import InputError

if TYPE_CHECKING:
    from sim.twin.simulated_uno import SimulatedUno
    from smolbot.core.arrays import FloatArray

CONTROL_ADDRESS = "127.0.0.1:31765"

FAULT_POLL_INTERVAL = 0.02
"""Time, in s, between two checks whether a fault is over."""

THREAD_SWITCH_INTERVAL = 5e-4
"""Time, in s, after which a thread yields to another: readers and the card's thread must not wait for each other."""

STREAM = 5
"""Random stream of a seed for the operator's delays; the tank uses 0 to 4."""

CLEAR_TIMEOUT = 2.0
"""Longest time, in s, for the stage to reset after its faults are cleared."""

WARM_UP = (500, 250)
"""Samples that are played and read at first, so that all kernels are compiled."""

ALL_LINES = 1_000_000
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
        self, rig: RigConfig, robot: RobotConfig, start: FloatArray, seed: int, *, control: str = CONTROL_ADDRESS
    ) -> None:
        section, settings = rig.section_of("bench", BenchSection), rig.section_of("tank", TankSettings)
        if not section.server or not section.truth:
            raise InputError(f"'{rig.name}' names no bench.server and bench.truth to listen on; use --rig twin.")
        self.section = section
        self.plant = TwinPlant(rig, robot, settings, np.asarray(start, dtype=np.float64), seed)
        self._warm_up()
        self.card = CardModel(section, self.plant, self._move_magnet_and_publish)
        self.card.faults.add_listener(self._apply_fault)
        mismatches = {"seed": seed, "ideal": settings.mismatch.scale == 0.0, **self.plant.list_mismatches()}
        own = np.random.default_rng([seed, STREAM])
        self._operator = MagnetOperator(rig.magnet.move_s, settings.lateness, own) if section.stage else None
        self._published_until = -math.inf
        self._last_turn = 0
        self._latest: dict[str, dict[str, Any]] = {}
        self._closing: list[Any] = []
        self.stage: SimulatedUno | None = None
        try:
            self.truth = TruthServer(*_parse_address(section.truth), mismatches)
            self._closing.append(self.truth)
            host, port = _parse_address(control)
            handlers = {
                "inject": self._inject,
                "clear": self._clear,
                "log": self._read_log,
                "state": self._read_state,
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
        sys.setswitchinterval(THREAD_SWITCH_INTERVAL)
        gc.collect()
        gc.freeze()  # garbage collection of all imports would stop the card's thread for 0.1 s
        self.card.start()

    def _warm_up(self) -> None:
        """Compile the kernels, so that the card's thread need not wait for them."""
        self.plant.advance(np.zeros((len(self.plant.loads), WARM_UP[0])))
        self.plant.begin_acquisition()
        self.plant.read_volts(0, WARM_UP[1])

    def _open_stage(self, section: StageSection) -> None:
        from sim.twin.simulated_uno import SimulatedUno

        self._per_turn = (2 * math.pi / section.steps_per_turn, 2 * math.pi / section.steering_steps_per_turn)
        self.stage = SimulatedUno()
        self.stage.start(Path(section.port))
        self._closing.append(self.stage)

    def _move_magnet_and_publish(self, until: float) -> None:
        """Move the magnet with the stage and publish the truth, before the tank plays to `until` s.

        Runs in the card's thread.
        """
        if self.stage is not None and self._operator is not None:
            hand = self._operator
            hand.update(self.stage.lamp, until)
            self.stage.set_switches(hand.magnet_position == "near", hand.magnet_position == "away")
            turn, steering = self.stage.steps
            near = None if hand.magnet_position is None else hand.magnet_position == "near"
            self.plant.set_magnet(turn * self._per_turn[0], steering * self._per_turn[1], near)
            self._log_change("motors", on=self.stage.enabled)
            self._log_change("magnet", place=hand.magnet_position or "on its way")
        times, poses = self.plant.history.find_rows_since(self._published_until)
        new = times > self._published_until
        if new.any():
            self._published_until = float(times[-1])
            at = self.card.compute_time(0) + times[new]
            self.truth.publish(np.column_stack([at, poses[new]]))

    def _log_change(self, what: str, **detail: Any) -> None:
        """Add an entry to the card's journal, if it has changed."""
        if self._latest.get(what) != detail:
            self._latest[what] = detail
            self.card.journal.add(what, **detail)

    def _apply_fault(self, name: str) -> None:
        if name == "killed":
            self.server.kill()
            while self.card.faults.is_active(name):
                time.sleep(FAULT_POLL_INTERVAL)
            self.server.restart()
        elif name in SERIAL_FAULTS and self.stage is not None:
            stage, lines = self.stage, ALL_LINES if self.card.faults.is_permanent(name) else 1
            actions: dict[str, Callable[[], None]] = {
                "serial_unplugged": stage.unplug,
                "serial_garbled": functools.partial(stage.garble, lines),
                "serial_truncated": functools.partial(stage.truncate, lines),
                "firmware_reset": stage.reset,
                "firmware_hung": stage.hang,
            }
            actions[name]()

    def inject(self, fault: InjectedFault) -> None:
        """Inject a fault.

        Parameters
        ----------
        fault : InjectedFault
        """
        self.card.faults.add(fault)

    def _inject(self, request: Mapping[str, Any]) -> str:
        self.inject(parse_fault(str(request["fault"])))
        return "waits"

    def _read_log(self, request: Mapping[str, Any]) -> list[dict[str, Any]]:
        return self.card.journal.list_since(int(request.get("since", 0)))

    def _clear(self, _: Mapping[str, Any]) -> str:
        self.card.faults.clear()
        if self.stage is not None and self._operator is not None:
            self.stage.plug()
            self.stage.garble(0)
            self.stage.truncate(0)
            self.stage.reset()
            end = time.monotonic() + CLEAR_TIMEOUT
            while self.stage.lamp is not None and time.monotonic() < end:
                time.sleep(FAULT_POLL_INTERVAL)
            self._operator.move_away()
            self.stage.turn_to_marks()
        return "cleared"

    def _read_state(self, _: Mapping[str, Any]) -> dict[str, Any]:
        found = dict(self.card.read_state()) | {"now": time.monotonic()}
        if self.stage is not None:
            turn, steering = self.stage.steps
            found |= {"motors_on": self.stage.enabled, "steps": [turn, steering], "lamp": self.stage.lamp}
            found["turning"], self._last_turn = turn != self._last_turn, turn
        return found

    def close(self) -> None:
        """Stop everything and release all resources; harmless when repeated."""
        self.card.faults.clear()
        self.card.close()
        while self._closing:
            self._closing.pop().close()
        self.plant.carrier.close()


def _parse_address(address: str) -> tuple[str, int]:
    host, _, port = address.rpartition(":")
    if not host or not port.isdigit():
        raise InputError(f"'{address}' is no address; use host:port, such as 127.0.0.1:31763.")
    return host, int(port)
