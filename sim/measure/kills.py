"""Kill missions with SIGKILL at random moments, and check that the remaining record is recovered and correct."""

from __future__ import annotations

import argparse
import itertools
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from smolbot.core.pose import Pose
from smolbot.runs.run import CycleRecord

ALLOWED = 0.5
"""Seconds of wall time before a kill that may be missing."""

PHASES = {"begin": 0.15, "learn": 0.2, "fly": 0.5, "end": 0.15}
"""Parts of a run, and the share of kills that fall into each."""

_POLL = 0.002
_PATIENCE = 300.0  # s for a mission to come to its moment


@dataclass
class Outcome:
    """Result of one kill.

    Attributes
    ----------
    phase : str
    cycles, recovered : int
        Printed as played; in the recovered record.
    flushed, messages : int
        Reported as flushed; read from the torn record.
    missing : float, in s
        Wall time from the first cycle that was played and is not in the record to the kill; 0 where none is missing.
    torn : bool
        Whether the kill left a torn record.
    took : float, in s
        For recovering.
    faults : list of str
        What is wrong, but for time; empty if nothing is.
    """

    phase: str
    cycles: int = 0
    recovered: int = 0
    flushed: int = 0
    messages: int = 0
    missing: float = 0.0
    torn: bool = False
    took: float = 0.0
    faults: list[str] = field(default_factory=list)

    @property
    def late(self) -> bool:
        """Whether more than `ALLOWED` is missing."""
        return self.missing > ALLOWED


@dataclass
class VictimOutput:
    """What a process printed before it was killed: when it began, flew and ended (s, monotonic), cycles and counts."""

    marks: dict[str, float] = field(default_factory=dict)
    cycles: list[tuple[float, dict[str, Any]]] = field(default_factory=list)
    flushed: list[tuple[float, int]] = field(default_factory=list)

    @classmethod
    def read(cls, log: Path) -> VictimOutput:
        """Read what a victim printed.

        Parameters
        ----------
        log : Path

        Returns
        -------
        VictimOutput
        """
        output = cls()
        for text in log.read_bytes().split(b"\n")[:-1]:  # what follows the last end of line was cut short
            line = json.loads(text)
            if line["kind"] == "cycle":
                output.marks.setdefault("fly", line["wall"])
                output.cycles.append((line["wall"], line))
                if line["last"]:
                    output.marks.setdefault("end", line["wall"])
            elif line["kind"] == "flushed":
                output.flushed.append((line["wall"], line["messages"]))
                output.marks.setdefault("learn", line["wall"])  # the beginning is on disk, and the first shot is played
            else:
                output.marks[line["kind"]] = line["wall"]
        return output


def kill_all(
    kills: int, seed: int, mission: str, settings: Mapping[str, str], folder: Path, show: Callable[[str], None] = print
) -> Iterator[Outcome]:
    """Fly once to the end, to learn how long each part takes; then kill as often as requested.

    Parameters
    ----------
    kills : int
    seed : int
    mission : str
    settings : mapping of str to str
    folder : Path
    show : callable
        Called with lines for people.

    Yields
    ------
    Outcome
    """
    rng = np.random.default_rng(seed)
    unharmed = Victim(folder / "unharmed", mission, seed, settings)
    unharmed.process.wait(_PATIENCE)
    marks = unharmed.read_output().marks
    names = [*PHASES, "done"]
    if not set(names) <= marks.keys():
        raise RuntimeError(f"the mission did not fly to its end: {unharmed.read_errors()}")
    lengths = {a: marks[b] - marks[a] for a, b in itertools.pairwise(names)}
    show("a run takes " + ", ".join(f"{name} {length:.2f} s" for name, length in lengths.items()))
    for number in range(kills):
        phase = str(rng.choice(list(PHASES), p=list(PHASES.values())))
        delay = float(rng.uniform(0.0, lengths[phase]))
        victim = Victim(folder / f"{number:03d}", mission, seed + number, settings)
        killed = victim.kill(phase, delay)
        yield check_recovery(victim, phase, killed)


class Victim:
    """A mission flown in a process of its own, which prints what it does.

    Parameters
    ----------
    folder : Path
    mission : str
    seed : int
    settings : mapping of str to str
    """

    def __init__(self, folder: Path, mission: str, seed: int, settings: Mapping[str, str]) -> None:
        folder.mkdir(parents=True)
        self.run = folder / "run"
        self._log = folder / "log"
        self._errors = folder / "errors"
        order = [
            sys.executable,
            "-m",
            "sim.measure.kills",
            "--victim",
            str(self.run),
            "--mission",
            mission,
            "--seed",
            str(seed),
        ]
        order += [part for key, value in settings.items() for part in ("--set", f"{key}={value}")]
        with self._log.open("wb") as log, self._errors.open("wb") as errors:
            self.process = subprocess.Popen(order, stdout=log, stderr=errors)

    def read_output(self) -> VictimOutput:
        """Return what it printed so far.

        Returns
        -------
        VictimOutput
        """
        return VictimOutput.read(self._log)

    def read_errors(self) -> str:
        """Return its error output.

        Returns
        -------
        str
        """
        return self._errors.read_text(errors="replace").strip()[-500:]

    def kill(self, phase: str, delay: float) -> float:
        """Kill it some time into a part of its run.

        Parameters
        ----------
        phase : str
        delay : float, in s

        Returns
        -------
        float, in s
            When, on the monotonic clock.
        """
        until = time.monotonic() + _PATIENCE
        while phase not in self.read_output().marks and self.process.poll() is None and time.monotonic() < until:
            time.sleep(_POLL)
        time.sleep(delay)
        killed = time.monotonic()
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()
        return killed


def check_recovery(victim: Victim, phase: str, killed: float) -> Outcome:
    """Recover a killed run and compare it with what its process had printed.

    Parameters
    ----------
    victim : Victim
    phase : str
    killed : float, in s

    Returns
    -------
    Outcome
    """
    from smolbot.errors import InputError
    from smolbot.runs.recording.reader import read_run
    from smolbot.runs.recover import recover

    output, out = victim.read_output(), Outcome(phase)
    out.cycles = len(output.cycles)
    out.flushed = max((count for _, count in output.flushed), default=0)
    begin = time.perf_counter()
    try:
        done = recover(victim.run)
        out.took = time.perf_counter() - begin
        again = recover(victim.run)
        run = read_run(victim.run)
    except InputError as error:
        if out.flushed or any(wall < killed - ALLOWED for wall, _ in output.cycles):
            out.faults.append(f"not recovered: {error}")
        return out
    out.messages, out.torn, out.recovered = done.found.messages, done.torn is not None, len(run.moments)
    if not run.whole or again.needed:
        out.faults.append("is not complete after it was recovered")
    if out.messages < out.flushed:
        out.faults.append(f"{out.flushed} messages were said to be flushed, {out.messages} are there")
    if run.number_of_cycle != list(range(out.recovered)):
        out.faults.append("cycles are missing in between")
    for (_, line), moment in zip(output.cycles, run.moments, strict=False):
        if line["poses"] != _format_poses(moment.cycle):
            out.faults.append(f"cycle {line['number']} is not what was played")
    if out.recovered < out.cycles:
        out.missing = killed - output.cycles[out.recovered][0]
    summary = json.loads((victim.run / "summary.json").read_bytes())
    if summary["cycles"] != out.recovered or not (victim.run / "path.png").is_file():
        out.faults.append("summary or picture are not those of the record")
    return out


def fly_as_victim(folder: Path, mission: str, seed: int, settings: Mapping[str, str]) -> None:
    """Fly as ``smolbot run`` does, and print every cycle as it is played.

    Parameters
    ----------
    folder : Path
    mission : str
    seed : int
    settings : mapping of str to str
    """
    from smolbot.config.load import AnyMission, load_mission
    from smolbot.flight.session import fly
    from smolbot.runs.folder import RunFolder
    from smolbot.runs.run import Listener

    def say(kind: str, **values: Any) -> None:
        line = json.dumps({"kind": kind, "wall": time.monotonic(), **values}) + "\n"
        os.write(1, line.encode())  # at once, and in one piece, from whichever thread

    class Teller:
        number = 0

        def __call__(self, record: CycleRecord) -> None:
            command = record.command
            say("cycle", number=self.number, poses=_format_poses(record), last=command.done or command.stuck)
            self.number += 1

    def listeners(_: AnyMission) -> tuple[Listener, ...]:
        return (Teller(),)

    loaded = load_mission(mission, settings=dict(settings))
    say("begin")
    fly(
        loaded, seed, folder=RunFolder(folder), settings=settings, make_listeners=listeners,
        on_flush=lambda count: say("flushed", messages=count),
    )  # fmt: skip
    say("done")


def _format_poses(record: CycleRecord) -> list[list[str] | None]:
    """Format the located and the tracked pose, to the last bit, and the next currents."""

    def exact(pose: Pose | None) -> list[str] | None:
        if pose is None:
            return None
        return [float(v).hex() for v in (pose.time, *pose.position, *pose.orientation, *pose.covariance.ravel())]

    return [exact(record.pose), exact(record.tracked), [repr(record.command)]]


HEADER = "kill moment  played  there  flushed   read  torn  missing   took"


def format_kill(number: int, outcome: Outcome) -> str:
    """Format one kill as a line of the table.

    Parameters
    ----------
    number : int
    outcome : Outcome

    Returns
    -------
    str
    """
    torn, failed = "yes" if outcome.torn else "no", [*outcome.faults, *["late"] * outcome.late]
    verdict = f"  FAILED: {'; '.join(failed[:3])}" if failed else ""
    return (
        f"{number:4d} {outcome.phase:7} {outcome.cycles:6d} {outcome.recovered:6d} {outcome.flushed:8d} "
        f"{outcome.messages:6d} {torn:>5} {outcome.missing:6.3f} s {outcome.took:4.1f} s{verdict}"
    )


def main() -> None:
    """Print the table; 1 if a run could not be recovered or is wrong."""
    parser = argparse.ArgumentParser(prog="python -m sim.measure.kills", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--mission", default="line")
    parser.add_argument("--set", action="append", default=[], help="key=value laid over the mission file")
    parser.add_argument("--json", action="store_true", help="print one JSON object on standard output")
    parser.add_argument("--victim", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    settings = dict(pair.split("=", 1) for pair in given.set)
    if given.victim is not None:
        fly_as_victim(given.victim, given.mission, given.seed, settings)
        return

    def show(text: str) -> None:
        print(text, file=sys.stderr if given.json else sys.stdout, flush=True)

    outcomes: list[Outcome] = []
    with tempfile.TemporaryDirectory() as folder:
        show(HEADER)
        for outcome in kill_all(given.kills, given.seed, given.mission, settings, Path(folder), show):
            show(format_kill(len(outcomes), outcome))
            outcomes.append(outcome)
    failed = sum(bool(o.faults) or o.late for o in outcomes)
    longest = max((o.missing for o in outcomes), default=0.0)
    before = sum(not o.messages for o in outcomes)
    show(
        f"{len(outcomes)} kills, {failed} failed; {before} came before anything was recorded or played; "
        f"{sum(o.torn for o in outcomes)} left a torn record; "
        f"at most {longest:.3f} s missing (allowed: {ALLOWED:g} s)"
    )
    if given.json:
        print(json.dumps({"failed": failed, "longest_missing_s": longest, "kills": [asdict(o) for o in outcomes]}))
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
