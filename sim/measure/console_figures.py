"""How quickly a STOP on the console brings the twin's outputs to zero, and what a console costs the loop.

Run it with ``python -m sim.measure.console_figures`` on a machine with nothing else to do. Twin, console, browser and
the process that flies stay; every stop begins a new loop, on a newly opened rig. A press is timed by the
browser when its input arrives, outputs by the twin's journal of commanded currents, both on the machine's monotonic
clock.
"""

from __future__ import annotations

import argparse
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sim.measure.browser import Browser, find_missing
from sim.measure.fault_cases import Bench, copy_rig_with_ports
from sim.twin.control import TwinControl
from smolbot.errors import RigError
from smolbot.ui.link.console_server import request_stop
from smolbot.ui.link.consoles import ENVIRONMENT, Console, read_console

WAYS = ("click", "leave", "command", "kill")
"""STOP pressed; pressed on a page that is gone the moment after; without a browser; the console's process killed."""

ALLOWED = {"click": (0.030, 0.150), "leave": (0.030, 0.150), "command": (0.030, 0.150), "kill": (None, 1.0)}
"""Median and worst, in s."""

ALLOWED_LATER = 0.002
"""How much later the 99th percentile of the loop may be, in s."""

FIRST_SHOT = 15
"""Shots after which a flight is stopped: it is found by then, and pulled."""


HEADER = (
    f"{'stop':8} {'times':>5} {'driven':>6} {'zero: median':>13} {'worst':>7} "
    f"{'at rest: median':>16} {'worst':>7} {'unsure':>7}  ms"
)


class EndedEarlyError(RigError):
    """A flight ended before it was stopped, so nothing was measured."""


@dataclass(frozen=True)
class Stop:
    """One stop; times in s from the press on.

    Attributes
    ----------
    zero : float
        Until the last sample that was driven; 0 where nothing was by then.
    rested : float
        Until the mission had everything at rest, power supply and all, by its own clock.
    driven : bool
        Whether anything was driven at the press.
    unsure : float
        Of the press, against the machine's clock.
    """

    way: str
    zero: float
    rested: float
    driven: bool
    unsure: float
    reason: str


class ConsoleBench:
    """Twin, console, browser and mission, each in a process of its own.

    Parameters
    ----------
    folder : Path
    first_port : int
    size : (int, int)
        Of the browser's window, in pixels.
    browser : bool
        Whether to open one.
    """

    def __init__(self, folder: Path, first_port: int, size: tuple[int, int], browser: bool) -> None:
        self.folder, self.port = folder, first_port + 8
        self.rig = copy_rig_with_ports("twin", folder, first_port)
        self._size, self._browse = size, browser
        self._bench = Bench(folder, "r_path", str(self.rig), (), f"127.0.0.1:{first_port + 2}")
        self._flights = 0

    @contextmanager
    def running(self) -> Iterator[ConsoleBench]:
        """Run all of them until the block ends."""
        with ExitStack() as closing:
            self.twin: TwinControl = closing.enter_context(self._bench.running())
            closing.callback(self._end_console)
            self.open_console()
            self.browser: Browser | None = None
            if self._browse:
                self.browser = closing.enter_context(Browser(*self._size))
                self.browser.open(self.console.address)
            command = [sys.executable, "-m", "sim.measure.flyer", "r_path", str(self.rig)]
            log = closing.enter_context((self.folder / "flier.log").open("w"))
            self._flier = closing.enter_context(
                subprocess.Popen(
                    command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True, env=self._environment
                )
            )
            closing.callback(self._flier.kill)
            yield self

    def open_console(self) -> None:
        """Open a console that shows only this bench's missions."""
        session = self.folder / "session"
        session.mkdir(exist_ok=True)
        place = {"XDG_RUNTIME_DIR": str(session)}
        command = [
            sys.executable,
            "-m",
            "smolbot",
            "console",
            "--port",
            str(self.port),
            "--runs",
            str(self.folder),
            "--json",
        ]
        with (self.folder / "console.log").open("a") as log:
            self._console = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, env=os.environ | place)
        assert self._console.stdout is not None
        if not self._console.stdout.readline():
            raise RigError(f"The console did not open: {(self.folder / 'console.log').read_text()}")
        path = session / "smolbot" / f"console-{self.port}.json"
        found = read_console(path)
        assert found is not None
        self.console: Console = found
        self._environment = os.environ | place | {ENVIRONMENT: str(path)}

    def _end_console(self) -> None:
        self._console.terminate()
        self._console.wait(20)

    def begin(self, **how: Any) -> None:
        """Start a flight.

        Parameters
        ----------
        **how
            Passed on to the flying process.
        """
        assert self._flier.stdin is not None
        self.twin.send_request("clear")
        self._flights += 1
        self._since = max([entry["number"] for entry in self.twin.read_log()[-1:]], default=0)
        self._flier.stdin.write(json.dumps(how) + "\n")
        self._flier.stdin.flush()

    def end(self) -> dict[str, Any]:
        """Wait until the flight is over.

        Returns
        -------
        dict
            What the flying process reported.
        """
        assert self._flier.stdout is not None
        line = self._flier.stdout.readline()
        if not line:
            raise RigError(f"The flier ended: {(self.folder / 'flier.log').read_text()[-2000:]}")
        report: dict[str, Any] = json.loads(line)
        return report

    def await_shot(self, number: int, timeout: float = 60.0) -> None:
        """Wait until a number of shots have listened since the flight began.

        Parameters
        ----------
        number : int
        timeout : float, in s

        Raises
        ------
        TimeoutError
            If they have not by then.
        """
        assert self._flier.stdout is not None
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            if select.select([self._flier.stdout], [], [], 0.0)[0]:
                flown = self.end()
                raise EndedEarlyError(f"{flown['status']}: {flown['reason']}")
            log = self.twin.send_request("log", since=self._since)
            if sum(e["what"] == "phase" and e.get("phase") == "listening" for e in log) >= number:
                return
            time.sleep(0.1)
        raise RigError(f"Shot {number} did not come within {timeout:g} s.")

    def stop(self, way: str, wait: float) -> Stop:
        """Fly, and stop the flight some time after the robot was found.

        Parameters
        ----------
        way : str
            Button, key or signal.
        wait : float, in s

        Returns
        -------
        Stop
        """
        browser = self.browser
        if way in ("click", "leave"):
            assert browser is not None
            browser.watch_clicks(then_leave=way == "leave")
        self.begin(live=True, seconds=60)
        self.await_shot(FIRST_SHOT)
        offset, unsure = browser.compare_clocks() if browser is not None and way in ("click", "leave") else (0.0, 0.0)
        time.sleep(wait)
        if way == "kill":
            pressed = time.monotonic()
            self._console.send_signal(signal.SIGKILL)
        elif way == "command":
            pressed = time.monotonic()
            with self.console.connect() as sock:
                request_stop(sock, "a measurement")
        else:
            assert browser is not None
            browser.press_stop()
        flown = self.end()
        time.sleep(0.2)
        if way == "kill":
            self._console.wait()
            self.open_console()
        if browser is not None and way != "command":
            if way != "click":
                browser.open(self.console.address)
            if way != "kill":
                pressed = offset + browser.read_press_time()
        log = [e for e in self.twin.send_request("log", since=self._since) if e["what"] == "driven"]
        at_press = [e["on"] for e in log if e["time"] <= pressed]
        return Stop(
            way,
            max(self.twin.read_state()["last_driven"] - pressed, 0.0),
            flown["rested"] - pressed,
            bool(at_press and at_press[-1]),
            unsure,
            f"{flown['status']}: {flown['reason']}",
        )

    def measure_lateness(self, seconds: float, *, shown: bool) -> list[float]:
        """Measure the lateness of one flight's cycles.

        Parameters
        ----------
        seconds : float
        shown : bool
            With console and recorder, or with neither.

        Returns
        -------
        list of float, in s
        """
        out = str(self.folder / f"flight{self._flights}") if shown else None
        self.begin(live=shown, out=out, seconds=seconds)
        flown = self.end()
        if flown["status"] not in ("timeout", "completed"):
            print(f"  a flight ended early: {flown['status']}: {flown['reason']}", flush=True)
        late: list[float] = flown["lateness"][FIRST_SHOT:]
        return late


def show_stops(stops: list[Stop]) -> bool:
    """Print a line for each way of stopping.

    Parameters
    ----------
    stops : list of Stop

    Returns
    -------
    bool
        Whether all kept to the limits.
    """
    fine = True
    print(HEADER)
    for way in WAYS:
        mine = [stop for stop in stops if stop.way == way]
        if not mine:
            continue
        zero = 1e3 * np.array([stop.zero for stop in mine if stop.driven] or [np.nan])
        rested = 1e3 * np.array([stop.rested for stop in mine])
        unsure = 1e3 * max(stop.unsure for stop in mine)
        driven = sum(stop.driven for stop in mine)
        print(
            f"{way:8} {len(mine):5d} {driven:6d} {np.median(zero):13.1f} {zero.max():7.1f} "
            f"{np.median(rested):16.1f} {rested.max():7.1f} {unsure:7.1f}"
        )
        median, worst = ALLOWED[way]
        fine &= max(float(np.nanmax(zero)), float(rested.max())) <= 1e3 * worst
        fine &= median is None or not float(np.median(zero)) > 1e3 * median
        for stop in mine:
            expected = "the console is gone" if way == "kill" else "stopped by the operator (console)"
            if expected not in stop.reason:
                fine = False
                print(f"         ended otherwise: {stop.reason}")
    return fine


def main() -> None:
    """Measure, print, and end with 1 if something took longer than is allowed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--clicks", type=int, default=10, help="of STOP on the page")
    parser.add_argument("--commands", type=int, default=10, help="stops without a page")
    parser.add_argument("--leaves", type=int, default=3, help="presses on a page that is left at once")
    parser.add_argument("--kills", type=int, default=3, help="of the console's process")
    parser.add_argument("--flights", type=int, default=2, help="with and without a console, for the loop's lateness")
    parser.add_argument("--seconds", type=float, default=20.0, help="of each of these flights")
    parser.add_argument("--no-browser", action="store_true", help="only what needs none")
    parser.add_argument("--size", default="900x620", help="of the browser's window: it is rendered by software here")
    parser.add_argument("--first-port", type=int, default=32793)
    given = parser.parse_args()
    reason = "" if given.no_browser else find_missing()
    if reason:
        sys.exit(f"{reason}; or leave the browser out with --no-browser.")
    width, _, height = given.size.partition("x")
    counts = {"click": given.clicks, "leave": given.leaves, "command": given.commands, "kill": given.kills}
    if given.no_browser:
        counts |= {"click": 0, "leave": 0}
    waits = np.random.default_rng(1)
    fine = True
    with tempfile.TemporaryDirectory() as folder:
        bench = ConsoleBench(Path(folder), given.first_port, (int(width), int(height)), not given.no_browser)
        with bench.running():
            stops, early = [], 0
            for way in WAYS:
                for number in range(counts[way]):
                    try:
                        stop = bench.stop(way, float(waits.uniform(0.0, 0.3)))
                    except EndedEarlyError as error:  # nothing was stopped; printed and counted
                        early += 1
                        print(f"  {way} {number + 1}: not measured, the flight ended before: {error}", flush=True)
                        continue
                    stops.append(stop)
                    print(
                        f"  {way} {number + 1}: zero {1e3 * stop.zero:.1f} ms, at rest {1e3 * stop.rested:.1f} ms, "
                        f"{'driven' if stop.driven else 'not driven'} at the press; {stop.reason[:90]}",
                        flush=True,
                    )
            if stops:
                fine &= show_stops(stops)
            if early:
                print(f"{early} flights ended before they were stopped, and were not measured")
            off, on = [], []
            for _ in range(given.flights):
                off += bench.measure_lateness(given.seconds, shown=False)
                on += bench.measure_lateness(given.seconds, shown=True)
    if off and on:
        without, with_ = np.percentile(1e3 * np.array(off), (50, 99)), np.percentile(1e3 * np.array(on), (50, 99))
        print(
            f"loop lateness: median {without[0]:.2f}, p99 {without[1]:.2f} ms without ({len(off)} cycles); "
            f"median {with_[0]:.2f}, p99 {with_[1]:.2f} ms with console and recorder ({len(on)} cycles)"
        )
        fine &= bool(with_[1] - without[1] < 1e3 * ALLOWED_LATER)
    sys.exit(0 if fine else 1)


if __name__ == "__main__":
    main()
