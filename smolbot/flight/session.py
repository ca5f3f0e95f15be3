"""A flight from start to end: open the rig, build the parts, run the loop, write a run folder."""

from __future__ import annotations

import gc
import logging
import re
from collections.abc import Callable, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

from smolbot.config.document import format_setting
from smolbot.config.load import AnyMission, load_mission
from smolbot.config.mission_base import MissionBase
from smolbot.config.observation import Observation
from smolbot.config.plugins import check_protocol, load_world
from smolbot.config.sensors import write_sensors
from smolbot.config.world import World
from smolbot.core.arrays import as_count
from smolbot.core.operator import Operator, SilentOperator, TerminalOperator
from smolbot.core.rig import ProvenanceReporter, Rig
from smolbot.core.thread_switching import shorten_switch_interval
from smolbot.errors import InputError, report_plugin_errors
from smolbot.flight.assembly import make_learned_sensors_file, make_loop
from smolbot.flight.loop import Loop
from smolbot.flight.pause import Pause
from smolbot.flight.preview.missions import Force, require_go
from smolbot.flight.safety.heat_store import HeatMemory
from smolbot.flight.safety.stop_latch import Latch
from smolbot.flight.safety.stop_signals import catch_stop_signals
from smolbot.runs.folder import PICTURE, RunFolder, collect_provenance
from smolbot.runs.outcome import draw_run_picture, summarise_run
from smolbot.runs.recording.converter import Converter
from smolbot.runs.recording.message_queue import MessageQueue, RecorderSinks
from smolbot.runs.recording.recorder import Recorder, make_begin_message, make_end_message
from smolbot.runs.recording.run_files import RunFiles
from smolbot.runs.run import CycleRecord, Listener, Run
from smolbot.runs.trace import Trace

_LOG = logging.getLogger(__name__)

LEARNED_SENSORS_FILE = "sensors_learned.toml"
"""File of a run folder with the sensor array as the flight has estimated it."""


def run(
    mission: str | AnyMission,
    rig: str | None = None,
    seed: int = 0,
    *,
    out: str | Path | None = None,
    gui: bool = False,
    witness: bool = True,
    operator: Operator | None = None,
    report: bool = True,
    force: Force | None = None,
    **overrides: Any,
) -> Run:
    """Fly a mission, or carry out an observation; the same from a notebook as from the command line.

    Parameters
    ----------
    mission : str or Mission
        Shipped name, path of a mission file, or a mission that was loaded.
    rig : str, optional
        Rig to fly on instead of the mission's own.
    seed : int
        The same seed gives the same run, bit for bit.
    out : path, optional
        Run folder to write; none is written without it.
    gui : bool
        Show the simulated world in a window, if there is a display.
    witness : bool
        Log the ground truth of a simulated world. Poses and commands do not depend on it.
    operator : Operator, optional
        Does by hand what no stage can do; by default, the person at the terminal.
    report : bool
        Whether to write ``report.html`` into the run folder after the run.
    force : {"preview"}, optional
        Fly even where the preview says no-go.
    **overrides
        Settings that replace those of the mission file, with ``__`` for the dot: ``controller__tolerance_mm=0.5``.

    Returns
    -------
    Run
        Status, every cycle, and the summary.

    Raises
    ------
    ConfigError, InputError
        For every fault in the files, and for every reason why the preview says no-go, before anything moves.

    Examples
    --------
    >>> import smolbot
    >>> run = smolbot.run("line", seed=2, force="preview", localization__quiet_s=0.0, stop__max_duration_s=0.5)
    >>> run.status, len(run.cycles) == len(run.table()["time"])
    ('timeout', True)
    """
    settings = {name.replace("__", "."): format_setting(value) for name, value in overrides.items()}
    if isinstance(mission, str):
        mission = load_mission(mission, rig, settings)
    elif not isinstance(mission, MissionBase):
        raise InputError(f"mission must be a name or path as text, or a loaded mission; got {mission!r}.")
    elif rig is not None or settings:
        raise InputError("rig and overrides belong to loading: pass the mission's name, or load it with them.")
    folder = None if out is None else RunFolder(Path(out))
    require_go(mission, force)
    latch = Latch()
    with catch_stop_signals(latch):
        return fly(
            mission, seed, folder=folder, settings=settings, gui=gui, witness=witness,
            operator=operator or TerminalOperator(), latch=latch, report=report,
        )  # fmt: skip


def fly(
    mission: AnyMission,
    seed: int = 0,
    *,
    folder: RunFolder | None = None,
    settings: Mapping[str, str] | None = None,
    gui: bool = False,
    witness: bool = True,
    make_listeners: Callable[[AnyMission], tuple[Listener, ...]] | None = None,
    opener: Callable[[AnyMission, int], Rig] | None = None,
    operator: Operator | None = None,
    latch: Latch | None = None,
    pause: Pause | None = None,
    make_live_sink: Callable[[Converter], MessageQueue] | None = None,
    on_flush: Callable[[int], None] | None = None,
    report: bool = False,
) -> Run:
    """Fly a loaded mission.

    Parameters
    ----------
    mission : Mission or Observation
    seed : int
        Seed of the simulated world.
    folder : RunFolder, optional
        Where to record the run; without it, nothing is written.
    settings : mapping, optional
        Settings that replaced those of the mission file, for the record.
    gui : bool
        Show the simulated world in a window, if there is a display.
    witness : bool
        Log the ground truth of a simulated world.
    make_listeners : callable, optional
        Makes further listeners of every cycle from the mission, such as a progress bar.
    opener : callable, optional
        Opens another rig than the rig file names, from mission and seed, such as ``sim.reduced.rig.open_reduced``.
    operator : Operator, optional
        Does by hand what no stage can do; nobody unless given.
    latch : Latch, optional
        Tripping it ends the run, from any thread.
    pause : Pause, optional
        Holding it pauses the run, from any thread.
    make_live_sink : callable, optional
        Makes one more recorder sink from the converter of sensor values, such as the message queue of a live page.
    on_flush : callable, optional
        Called with the number of messages that are on disk, each time that it grows.
    report : bool
        Whether to write the report into the folder once the rig is closed. If that fails, the run is complete
        nevertheless, and `Run.report` gives the reason.

    Returns
    -------
    Run
        Status, every cycle, and the summary.

    Raises
    ------
    Exception
        Unexpected errors are raised again once all outputs are at zero and the folder is written.
    """
    seed = as_count(seed, 0, "seed")
    latch = latch if latch is not None else Latch()
    rig = open_rig(mission, seed, gui=gui, operator=operator) if opener is None else opener(mission, seed)
    try:
        latch.bind(rig.stop)
        flight = _Flight(mission, seed, folder, settings or {}, latch, pause)
        flown = flight.fly(rig, witness, make_listeners, make_live_sink, on_flush)
    finally:
        rig.close()
    if report and folder is not None:
        flown.report = _write_report(mission, folder.path)
    return flown


def open_rig(mission: AnyMission, seed: int = 0, *, gui: bool = False, operator: Operator | None = None) -> Rig:
    """Open the world that a mission's rig file names, with the robot at the mission's start position.

    Parameters
    ----------
    mission : Mission or Observation
    seed : int
        Seed of a simulated world.
    gui : bool
        Show a simulated world in a window, if there is a display.
    operator : Operator, optional
        Does by hand what no stage can do; nobody unless given.

    Returns
    -------
    Rig
        To be closed by the caller, such as with ``contextlib.closing``.

    Raises
    ------
    RigError
        If a device cannot be opened; no output was switched on.
    PluginError
        If what the world opens does not implement the protocol `Rig`.
    """
    seed = as_count(seed, 0, "seed")
    world: World = load_world(mission.rig.world, mission.rig.document)
    place = mission.start if isinstance(mission, Observation) else mission.start_placement
    with report_plugin_errors("World", world, "open"):
        rig = world.open(mission.rig, mission.robot, place, seed, gui=gui, operator=operator or SilentOperator())
    check_protocol(rig, Rig, f"What world '{mission.rig.world}' opens")
    return rig


def _write_report(mission: AnyMission, folder: Path) -> str:
    """Write the report of a run that is over; return its path, or why it could not be written."""
    from smolbot.runs.report.page import save_report
    from smolbot.runs.report.recorded_flight import RecordedFlight

    try:
        return str(save_report(RecordedFlight.read(folder, mission)))
    except Exception as error:
        _LOG.warning("%s: the report could not be written", folder, exc_info=error)
        return f"could not be written: {type(error).__name__}: {error}"


class _Flight:
    """One flight on an open rig, with its listeners and its run folder."""

    def __init__(
        self,
        mission: AnyMission,
        seed: int,
        folder: RunFolder | None,
        settings: Mapping[str, str],
        latch: Latch,
        pause: Pause | None,
    ) -> None:
        self.mission = mission
        self.seed = seed
        self.folder = folder
        self.settings = settings
        self.latch = latch
        self.pause = pause
        self.sampled: dict[str, Any] = {}
        self.trace = Trace(None)
        self.n_recorded = 0
        self.sinks: RecorderSinks = RecorderSinks(())

    def fly(
        self,
        rig: Rig,
        witness: bool,
        listeners: Callable[[AnyMission], tuple[Listener, ...]] | None,
        live: Callable[[Converter], MessageQueue] | None,
        flushed: Callable[[int], None] | None,
    ) -> Run:
        mission = self.mission
        self.sampled = rig.provenance() if isinstance(rig, ProvenanceReporter) else {}
        self.trace = Trace(rig.witness if witness else None)
        real = rig.witness is None  # the coils of a simulated world start cold
        memory = HeatMemory.from_rig_name(mission.rig.name) if real else None
        extra = listeners(mission) if listeners else ()
        self.sinks = self._begin(live, flushed)
        try:
            loop = make_loop(rig, mission, (self._record_cycle, *extra), self.latch, memory, self.sinks, self.pause)
            gc.freeze()  # garbage collection skips what exists by now, so that the robot waits less
            try:
                with shorten_switch_interval():
                    loop.fly()
            finally:
                gc.unfreeze()
                self._finish(loop)
        finally:
            self.sinks.close()
        return loop.run

    def _begin(
        self, live: Callable[[Converter], MessageQueue] | None, flushed: Callable[[int], None] | None
    ) -> RecorderSinks:
        """Write the run's files and provenance, and pass them to the recorder and to the live page."""
        converter = Converter.of(self.mission.rig.sections.sensors, self.mission.rig.sensor_gains)
        queues = [] if live is None else [live(converter)]
        if self.folder is None and not queues:
            return RecorderSinks(())
        files = RunFiles.of(self.mission)
        provenance = collect_provenance(self.seed, self.settings, self.sampled)
        if self.folder is not None:
            self.folder.begin(files.contents, provenance)
            queues.insert(0, Recorder(self.folder.path, converter, flushed))
        sinks = RecorderSinks(tuple(queues))
        sinks.record_message("/run/begin", 0.0, make_begin_message(files, provenance, converter))
        return sinks

    def _record_cycle(self, record: CycleRecord) -> None:
        before = self.trace.moments[-1].cycle.shot.mode if self.trace.moments else ""
        if record.shot.mode == "lost" != before:
            _LOG.warning("%.3f s: the signal is lost; searching", record.shot.start)
        self.trace(record)
        moment = self.trace.moments[-1]
        if self.folder is not None:
            self.folder.record(moment)
        self.sinks.record_cycle(len(self.trace.moments) - 1, moment)
        self.n_recorded = len(self.trace.moments)

    def _finish(self, loop: Loop) -> None:
        """Summarize a flight, however it ended, and complete its folder."""
        flown, folder, trace = loop.run, self.folder, self.trace
        if flown.status == "stopped":  # perhaps between a cycle and its record
            for record in flown.cycles[len(trace.moments) :]:
                trace(record)
            if folder is not None:
                for moment in trace.moments[folder.rows :]:
                    folder.record(moment)
            for number in range(self.n_recorded, len(trace.moments)):
                self.sinks.record_cycle(number, trace.moments[number])
        level = logging.INFO if flown.status == "completed" else logging.WARNING
        _LOG.log(level, "%.3f s: %s: %s", flown.duration, flown.status, flown.stop_reason)
        flown.true_trail = trace.true_positions() if trace.knows_truth else None
        flown.folder = str(folder.path) if folder is not None else None
        self.sinks.record_message("/run/end", flown.duration, make_end_message(flown), wait=True)
        self.sinks.close()
        flown.summary = summarise_run(self.mission, flown, trace, self.seed, self.sampled)
        if folder is not None:
            figures = self.sinks.collect_figures()
            flown.summary["recording"] = {**figures, "error": figures["error"] or folder.error}
            try:
                if loop.array_filter is not None and loop.array_filter.recordings:
                    write_sensors(
                        folder.path / LEARNED_SENSORS_FILE, make_learned_sensors_file(self.mission, loop.array_filter)
                    )
                folder.end(flown.summary)
                draw_run_picture(self.mission, flown, trace, folder.path / PICTURE)
            except OSError as error:
                raise InputError(f"{folder.path}: the run's folder cannot be completed: {error}.") from error


def make_run_folder(mission: MissionBase, seed: int, base: Path = Path("runs")) -> RunFolder:
    """Choose a run folder that does not exist yet, named by mission, local time and seed.

    Parameters
    ----------
    mission : Mission or Observation
    seed : int
    base : path
        Folder in which the run folder will be.

    Returns
    -------
    RunFolder
    """
    stem = re.sub(r"[^A-Za-z0-9_-]", "_", mission.name)
    stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
    name = f"{stem}-{stamp}-seed{seed}"
    path, number = base / name, 2
    while path.exists():
        path, number = base / f"{name}-{number}", number + 1
    return RunFolder(path)
