"""Every fault at three moments of a mission on the twin: how long until all is at rest, and what is printed.

Run it with ``python -m sim.measure.fault_cases``; it prints a table, one line per case, and ends with 1 if one failed.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sim.twin.control import TwinControl
from smolbot.errors import RigError

FAULT_SHOT = 16
"""The electrical shot in which a fault occurs: the robot is found by then, and pulled."""

ALLOWED = 0.150
"""Seconds until every output is zero and every relay open."""

ALLOWED_MAGNET = 1.0
"""Seconds until the magnet's motors are off."""

CARD_FAULTS = (
    "device_gone:once", "device_gone:good", "overrun:good", "read_timeout:good", "stalled:good", "killed:good",
    "watchdog_expired:once", "value_out_of_range:good", "relay_stuck:good", "sensor_dead:good",
    "sensors_saturated:good", "button:good",
)  # fmt: skip
SERIAL_FAULTS = (
    "serial_unplugged:good", "serial_garbled:good", "serial_truncated:good", "firmware_reset:once", "firmware_hung:good"
)  # fmt: skip
SIGNALS = ("kill -9", "SIGTERM", "Ctrl-C twice")
WIDE = {"COLUMNS": "400"}  # so that its output is not broken into lines

PHASES = ("before", "actuation", "listening")


@dataclass
class Outcome:
    """Result of one case; times in s from the fault on."""

    fault: str
    phase: str
    code: int
    zero: float
    opened: float
    motors: float | None
    ended: float
    output: str
    cycles: int
    complete: bool

    @property
    def reason(self) -> str:
        """Why the case failed; empty if it did not."""
        killed = self.fault == "kill -9"
        found = []
        if max(self.zero, self.opened) > ALLOWED:
            found.append("too late")
        if self.motors is not None and self.motors > ALLOWED_MAGNET:
            found.append("motors too late")
        if self.code != (-signal.SIGKILL if killed else 3):
            found.append(f"exit code {self.code}")
        if not self.complete:
            found.append("run folder not complete")
        return ", ".join(found)


class Bench:
    """A twin in a process of its own, and missions run on it.

    Parameters
    ----------
    folder : Path
    mission : str
    rig : str
    settings : tuple of str
        Of the mission, as for ``--set``.
    control : str
        Address of the twin's control port.
    """

    def __init__(self, folder: Path, mission: str, rig: str, settings: tuple[str, ...], control: str) -> None:
        self.folder, self.mission, self.rig, self.settings = folder, mission, rig, settings
        self.control = control
        self._number = 0

    @contextmanager
    def running(self) -> Iterator[TwinControl]:
        """Run the twin until the block ends."""
        command = [sys.executable, "-m", "smolbot", "twin", self.mission, "--rig", self.rig, "--control", self.control]
        log = (self.folder / "twin.log").open("w")
        process = subprocess.Popen([*command, "--json"], stdout=subprocess.PIPE, stderr=log, text=True)
        assert process.stdout is not None
        try:
            if not process.stdout.readline():
                raise RigError(f"The twin did not start: {(self.folder / 'twin.log').read_text()}")
            with TwinControl(self.control, timeout=20.0) as control:
                yield control
        finally:
            process.terminate()
            process.wait(10)
            log.close()

    def fly(self, twin: TwinControl, fault: str, phase: str, *, turning: bool = False) -> Outcome:
        """Run one mission with one fault, or signal, at one moment.

        Parameters
        ----------
        twin : TwinControl
        fault : str
        phase : str
        turning : bool
            Whether the magnet stage is involved.

        Returns
        -------
        Outcome
        """
        twin.send_request("clear")
        before = max([entry["number"] for entry in twin.read_log()[-1:]], default=0)
        self._number += 1
        out = self.folder / f"run{self._number}"
        name, _, lasting = fault.partition(":")
        if fault not in SIGNALS and not turning:
            twin.inject(f"{name}@{phase}#{FAULT_SHOT}:{lasting}")
        elif fault == "kill -9":  # the driver dies with its host, and leaves everything as it is
            twin.inject(f"outputs_frozen@{phase}#{FAULT_SHOT}:good")
        settings = [part for text in self.settings for part in ("--set", text)]
        command = [sys.executable, "-m", "smolbot", "run", self.mission, "--rig", self.rig, "--out", str(out),
                   "--force", "preview"]  # fmt: skip
        process = subprocess.Popen(
            [*command, *settings], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=os.environ | WIDE
        )
        try:
            at = self._await_fault(twin, process, fault, phase, before, turning)
            motors = self._find_motors_off(twin, at) if turning else None
            output, _ = process.communicate(timeout=90)
        except BaseException:
            process.kill()
            raise
        ended = time.monotonic()
        time.sleep(0.3)  # what is left to the watchdog has happened by then
        state = twin.read_state()
        stuck = name == "relay_stuck"
        opened = self._find_relay_opening(twin, before, at) if stuck else state["last_closed"] - at
        cycles, complete = self._check_folder(out, process.returncode)
        text = " ".join(output.split())
        return Outcome(
            fault, phase, process.returncode, max(state["last_driven"] - at, 0.0), max(opened, 0.0), motors,
            ended - at, text, cycles, complete,
        )  # fmt: skip

    def _await_fault(
        self, twin: TwinControl, process: subprocess.Popen[str], fault: str, phase: str, before: int, turning: bool
    ) -> float:
        """Return when the fault occurred, or the signal was sent."""
        end = time.monotonic() + 60.0
        while time.monotonic() < end:
            if process.poll() is not None:
                found = [e for e in twin.send_request("log", since=before) if e["what"] == "fault"]
                if found:
                    return float(found[0]["time"])
                assert process.stdout is not None
                raise RigError(f"The run ended before {fault} occurred: {process.stdout.read()}")
            if turning and self._is_stage_moment(twin, phase):
                name, _, lasting = fault.partition(":")
                twin.inject(f"{name}@now:{lasting}")
                return time.monotonic()
            if not turning:
                entries = twin.send_request("log", since=before)
                faults = [e for e in entries if e["what"] == "fault"]
                if fault not in SIGNALS and faults:
                    return float(faults[0]["time"])
                if fault == "kill -9" and faults:
                    process.send_signal(signal.SIGKILL)
                    return time.monotonic()
                if fault in SIGNALS and fault != "kill -9" and self._has_reached(entries, phase):
                    return _send(process, fault)
            time.sleep(0.002)
        raise RigError(f"{fault} at {phase} did not occur within a minute.")

    @staticmethod
    def _has_reached(entries: list[dict[str, Any]], phase: str) -> bool:
        expected, shot = ("listening", FAULT_SHOT - 1) if phase == "before" else (phase, FAULT_SHOT)
        return any(e["what"] == "phase" and e["phase"] == expected and e["shot"] == shot for e in entries)

    @staticmethod
    def _is_stage_moment(twin: TwinControl, phase: str) -> bool:
        """Before: the magnet is requested; actuation: it turns; listening: it is away again."""
        state = twin.read_state()
        if phase == "before":
            return state["lamp"] == "near"
        if phase == "actuation":
            return bool(state["turning"])
        return bool(state["lamp"] == "away")

    @staticmethod
    def _find_motors_off(twin: TwinControl, at: float) -> float:
        """Return when the motors' drivers went off, after a fault of the stage."""
        while time.monotonic() < at + 5.0:
            if not twin.read_state()["motors_on"]:
                return time.monotonic() - at
            time.sleep(0.005)
        return float("inf")

    @staticmethod
    def _find_relay_opening(twin: TwinControl, before: int, at: float) -> float:
        """Return when the amplifiers were off: contacts that stick carry nothing then."""
        offs = [e["time"] for e in twin.send_request("log", since=before) if e["what"] == "enabled" and not e["on"]]
        return float(max(offs) - at) if offs else 0.0

    @staticmethod
    def _check_folder(out: Path, code: int) -> tuple[int, bool]:
        """Return the number of recorded cycles, and whether the folder is complete up to the fault."""
        names = ["mission.toml", "rig.toml", "robot.toml", "provenance.json"]
        complete = all((out / name).is_file() for name in names)
        cycles = 0
        table = out / "cycles.csv"
        if table.is_file():
            with table.open(newline="", encoding="utf-8") as file:
                rows = list(csv.DictReader(file))
            cycles = len(rows)
            complete &= [int(row["cycle"]) for row in rows] == list(range(cycles))
        if code != -signal.SIGKILL:
            summary = out / "summary.json"
            complete &= summary.is_file() and json.loads(summary.read_text(encoding="utf-8"))["cycles"] == cycles
        return cycles, complete


def _send(process: subprocess.Popen[str], what: str) -> float:
    at = time.monotonic()
    if what == "SIGTERM":
        process.send_signal(signal.SIGTERM)
    else:
        process.send_signal(signal.SIGINT)
        time.sleep(0.02)
        process.send_signal(signal.SIGINT)
    return at


def copy_rig_with_ports(rig: str, folder: Path, first: int) -> Path:
    """Copy a shipped twin's rig file with other ports, so that it disturbs no other twin.

    Parameters
    ----------
    rig : str
    folder : Path
    first : int
        First port.

    Returns
    -------
    Path
    """
    from smolbot.config.library import find_file

    text = find_file(rig, "rigs").read_text(encoding="utf-8")
    for offset, port in enumerate((31763, 31764)):
        text = text.replace(f"127.0.0.1:{port}", f"127.0.0.1:{first + offset}")
    text = text.replace("127.0.0.1::31766", f"127.0.0.1::{first + 3}")
    text = text.replace("runs/twin-stage", str(folder / "stage"))
    path = folder / f"{rig}.toml"
    path.write_text(text, encoding="utf-8")
    return path


def list_cases(only: str = "") -> Iterator[tuple[bool, str, str]]:
    """List the cases.

    Parameters
    ----------
    only : str
        Part of the name of the fault.

    Yields
    ------
    stage : bool
        Whether it concerns the magnet stage.
    fault, phase : str
    """
    for fault in (*CARD_FAULTS, *SIGNALS):
        for phase in PHASES:
            if only in fault:
                yield False, fault, phase
    for fault in SERIAL_FAULTS:
        for phase in PHASES:
            if only in fault:
                yield True, fault, phase


def run_cases(folder: Path, only: str = "", first_port: int = 32763) -> Iterator[Outcome]:
    """Run every case whose fault's name contains `only`, one after the other.

    Parameters
    ----------
    folder : Path
    only : str
    first_port : int

    Yields
    ------
    Outcome
    """
    chosen = list(list_cases(only))
    for turning, mission, rig, settings in (
        (False, "r_path", "twin", ("localization.quiet_s=2", "stop.max_duration_s=30")),
        (True, "s_path", "twin_gel", ("localization.quiet_s=2", "rig.magnet.move_s=1.5")),
    ):
        mine = [(fault, phase) for of_stage, fault, phase in chosen if of_stage == turning]
        if not mine:
            continue
        own = folder / rig
        own.mkdir()
        path = copy_rig_with_ports(rig, own, first_port)
        if turning:
            path.write_text(path.read_text(encoding="utf-8").replace("move_s = 10.0", "move_s = 1.5"), encoding="utf-8")
        bench = Bench(own, mission, str(path), settings, f"127.0.0.1:{first_port + 2}")
        with bench.running() as twin:
            for fault, phase in mine:
                yield bench.fly(twin, fault, phase, turning=turning)


HEADER = (
    f"{'fault':24} {'moment':10} {'code':>4} {'zero':>7} {'relays':>7} {'motors':>7} {'ended':>7} {'cycles':>6}  output"
)


def format_case(outcome: Outcome) -> str:
    """Format one case as a line of the table; times in ms.

    Parameters
    ----------
    outcome : Outcome

    Returns
    -------
    str
    """
    motors = "" if outcome.motors is None else f"{1e3 * outcome.motors:.0f}"
    verdict = f"FAILED ({outcome.reason}) " if outcome.reason else ""
    output = outcome.output[outcome.output.find("status") :][:150]
    return (
        f"{outcome.fault:24} {outcome.phase:10} {outcome.code:4d} {1e3 * outcome.zero:7.1f} "
        f"{1e3 * outcome.opened:7.1f} {motors:>7} {1e3 * outcome.ended:7.0f} {outcome.cycles:6d}  {verdict}{output}"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--only", default="", help="faults whose name holds this")
    only = parser.parse_args().only
    failed = count = 0
    with tempfile.TemporaryDirectory() as folder:
        print(HEADER)
        for outcome in run_cases(Path(folder), only):
            print(format_case(outcome), flush=True)
            count, failed = count + 1, failed + bool(outcome.reason)
    print(f"{count} cases, {failed} failed; allowed: {1e3 * ALLOWED:.0f} ms, magnet {1e3 * ALLOWED_MAGNET:.0f} ms")
    sys.exit(os.EX_OK if not failed else 1)


if __name__ == "__main__":
    main()
