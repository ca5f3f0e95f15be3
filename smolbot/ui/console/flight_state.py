"""State of one run for the page, built from the messages of its record, live or from disk."""

from __future__ import annotations

import bisect
import json
import tempfile
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from smolbot.config.load import AnyMission
from smolbot.config.mission import Mission
from smolbot.core.arrays import FloatArray
from smolbot.core.coil_heat import CoilHeat, compute_mean_square_currents
from smolbot.core.shots import Actuate, Excite, Rotate, Shot
from smolbot.runs.recording import messages
from smolbot.runs.recording.run_files import RunFiles
from smolbot.ui.console.time_series import TimeSeries

RATE_CYCLES = 12
"""Number of cycles over which the rate is averaged."""


@dataclass(frozen=True)
class CycleText:
    """Texts of one cycle.

    Attributes
    ----------
    time : float, in s
        On the rig's clock.
    mode : str
        Mode of the shot.
    phase : str
        Phase of the command.
    note : str
        Note of the command.
    rig : str
        Status line of the rig.
    """

    time: float
    mode: str
    phase: str
    note: str
    rig: str


@dataclass(frozen=True)
class Ending:
    """End of a run.

    Attributes
    ----------
    status : str
    reason : str
    time : float, in s
        On the rig's clock.
    """

    status: str
    reason: str
    time: float


class FlightState:
    """Collects the messages of one run. It may be read from any thread, completely or up to a time.

    Parameters
    ----------
    name : str
        Name to show until the first message has come.

    Attributes
    ----------
    name : str
        Name to show.
    mission : Mission, Observation or None
        None until the record's first message has come.
    tracked : TimeSeries
        Position in mm (3), quaternion (4), sigma in mm, whether it is trusted.
    raw : TimeSeries
        Position in mm (3).
    true : TimeSeries
        Position in mm (3); empty in a world without ground truth.
    cycles : TimeSeries
        Error to the path in mm (nan off the path), R², progress (0 to 1), compute time in ms.
    currents : TimeSeries
        Current of each actuation coil during a shot, in A; if the rig has a magnet, its turns per second.
    heat : TimeSeries
        Temperature of each coil with known thermal constants, in degrees Celsius.
    """

    def __init__(self, name: str = "") -> None:
        self.name = name
        self.mission: AnyMission | None = None
        self.lock = threading.Lock()
        self.seed: int | None = None
        self.ending: Ending | None = None
        self.latest = 0.0
        self.dropped = 0
        self.version = 0
        self.tracked, self.raw, self.true = TimeSeries(9), TimeSeries(3), TimeSeries(3)
        self.cycles = TimeSeries(4)
        self.currents, self.heat = TimeSeries(0), TimeSeries(0)
        self.coils: tuple[str, ...] = ()
        self.heated: tuple[str, ...] = ()
        self.texts: list[CycleText] = []
        self.happened: list[tuple[float, str]] = []
        self._heat: CoilHeat | None = None
        self._parts: dict[str, Any] = {}
        self._modes: dict[int, str] = {}
        self._cooled = 0.0

    def add_message(self, topic: str, data: bytes) -> None:
        """Add one message of the record. Topics that the page does not use are ignored.

        Parameters
        ----------
        topic : str
        data : bytes
            Serialized protobuf message.
        """
        kind = messages.TOPICS.get(topic)
        if kind is None or topic == "/windows":
            return
        message = kind.FromString(data)
        with self.lock:
            self._dispatch(topic, message)
            self.version += 1

    def _dispatch(self, topic: str, message: Any) -> None:
        match topic:
            case "/run/begin":
                self._begin(message)
            case "/shots":
                self._add_shot(message.number, messages.decode_shot(message), message.ended)
            case "/poses/raw" | "/poses/tracked" | "/poses/true" | "/commands":
                self._parts[topic] = message
            case "/timing":
                self._add_cycle(message)
                self._parts = {}
            case "/events":
                self.happened.append((message.time, message.what))
            case "/run/dropped":
                self.dropped = message.messages
            case "/run/end":
                self.ending = Ending(message.status, message.stop_reason, message.duration)
                self.latest = max(self.latest, message.duration)

    def _begin(self, message: Any) -> None:
        with tempfile.TemporaryDirectory() as folder:
            for name, content in message.files.items():
                (Path(folder) / Path(name).name).write_bytes(content)
            mission = RunFiles(dict(message.files), dict(message.names)).load(Path(folder))
        self.seed = json.loads(message.provenance).get("seed")
        rig = mission.rig
        self.coils = rig.coil_names if rig.sections.magnet is None else ("magnet",)
        self.currents = TimeSeries(len(self.coils))
        self._heat = CoilHeat(rig.thermal, rig.sections.safety.ambient_c)
        self.heated = tuple(coil.name for coil in self._heat.coils if coil is not None)
        self.heat = TimeSeries(len(self.heated))
        self.name = f"{mission.name} on {rig.name}"
        self.mission = mission

    def _add_shot(self, number: int, shot: Shot, ended: float) -> None:
        self._modes[number] = shot.mode
        self.latest = max(self.latest, ended)
        if self.mission is None or self._heat is None:
            return
        driven = np.zeros(len(self.coils))
        n, m = len(self.mission.rig.coil_names), len(self.mission.rig.sections.excitation)
        self._heat.advance((), shot.start - self._cooled)
        for window in shot.windows:
            if isinstance(window, Actuate) and len(window.currents) == len(driven):
                driven = np.array(window.currents)
            elif isinstance(window, Rotate):
                driven = np.full(len(self.coils), window.frequency)
            self._heat.advance(
                compute_mean_square_currents(window, n, m) if isinstance(window, Actuate | Excite) else (),
                window.duration,
            )
        self._cooled = shot.end
        self.currents.append(shot.start, driven)
        pairs = zip(self._heat.coils, self._heat.temperatures, strict=True)
        self.heat.append(shot.end, [t for coil, t in pairs if coil is not None])

    def _add_cycle(self, timing: Any) -> None:
        parts = self._parts
        time = float(timing.ended)
        raw, tracked, true = (parts.get(f"/poses/{name}") for name in ("raw", "tracked", "true"))
        command = parts.get("/commands")
        phase = command.phase if command is not None else ""
        error = progress = np.nan
        if raw is not None:
            self.raw.append(raw.time, 1e3 * np.array(raw.position))
        if tracked is not None:
            place = np.array(tracked.position)
            sigma = 1e3 * float(np.sqrt(max(np.trace(np.reshape(tracked.covariance, (6, 6))[:3, :3]), 0.0) / 3.0))
            self.tracked.append(tracked.time, [*(1e3 * place), *tracked.orientation, sigma, float(tracked.trusted)])
            if isinstance(self.mission, Mission) and phase == "follow":
                error = 1e3 * float(self.mission.path.project(place[None, :])[1][0])
        if true is not None:
            for place in np.array(true.way).reshape(-1, 3):
                self.true.append(time, 1e3 * place)
            for pose in (true.pose, true.end):
                if pose.position:
                    self.true.append(pose.time, 1e3 * np.array(pose.position))
        if command is not None and isinstance(self.mission, Mission):
            progress = command.progress / self.mission.path.length
        squared = raw.r_squared if raw is not None else np.nan
        self.cycles.append(time, [error, squared, progress, 1e3 * timing.compute])
        note = command.note if command is not None else ""
        self.texts.append(CycleText(time, self._modes.pop(timing.shot, "track"), phase, note, timing.rig))
        self.latest = max(self.latest, time)

    @property
    def steers(self) -> bool:
        """True for a mission that follows a path."""
        return isinstance(self.mission, Mission)

    @property
    def tolerance(self) -> float | None:
        """Tolerance in mm; None if no path is followed."""
        return 1e3 * self.mission.tolerance if isinstance(self.mission, Mission) else None

    def compute_rate(self, time: float | None = None) -> float:
        """Compute the cycle rate over the last `RATE_CYCLES` cycles.

        Parameters
        ----------
        time : float, in s, optional
            On the rig's clock; the latest unless given.

        Returns
        -------
        float, in Hz
            nan before there are two cycles.
        """
        times = self.cycles.get_times(time)[-RATE_CYCLES:]
        return float((len(times) - 1) / (times[-1] - times[0])) if len(times) > 1 and times[-1] > times[0] else np.nan

    def find_text(self, time: float | None = None) -> CycleText | None:
        """Return the texts of the last cycle.

        Parameters
        ----------
        time : float, in s, optional
            On the rig's clock; the latest unless given.

        Returns
        -------
        Said or None
            None before the first cycle.
        """
        n = self.cycles.count_until(time)
        return self.texts[n - 1] if n else None

    def is_paused(self, time: float | None = None) -> bool:
        """Return whether the run was paused.

        Parameters
        ----------
        time : float, in s, optional
            On the rig's clock; the latest unless given.

        Returns
        -------
        bool
        """
        known = self.list_events(time)
        return next((what == "paused" for _, what in reversed(known) if what in ("paused", "resumed")), False)

    def list_events(self, time: float | None = None) -> list[tuple[float, str]]:
        """Return the events in order.

        Parameters
        ----------
        time : float, in s, optional
            On the rig's clock; the latest unless given.

        Returns
        -------
        list of (float, str)
            Time in s, and what happened.
        """
        if time is None:
            return list(self.happened)
        return self.happened[: bisect.bisect_right([at for at, _ in self.happened], time)]

    def get_heat_limits(self) -> FloatArray:
        """Return the temperature limit of each coil in `heated`.

        Returns
        -------
        ndarray, shape (n,), in degrees Celsius
        """
        return np.array([coil.limit for coil in self._heat.coils if coil is not None]) if self._heat else np.zeros(0)
