"""Faults by name, as the command line spells them: what fails, when, and for how long. Tank and twin share the grammar.

``NAME[.CHANNEL][=VALUE[,VALUE]][@MOMENT][:LASTING]``: ``sensor_gain.3=0.5@30s:10`` gives sensor 3 half its gain, from
30 s after the first shot on, for 10 s; ``excitation_lost@listening#40:once``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from smolbot.core.shots import Actuate, Listen, MoveMagnet, Rotate, Shot
from smolbot.errors import InputError, suggest_name

ONCE, GOOD = 0.0, math.inf
"""Durations, in s, of a fault that occurs once, and of one that stays."""

STATE_DURATION = 0.3
"""Duration, in s, of a state, such as a dead sensor, that occurs once."""

FROM_THE_START = 0.0
"""Time, in s, at which a fault begins that is there before the first shot: a rig's clock starts at 0."""

_MOMENT = re.compile(r"^(?:(?P<phase>before|actuation|listening)#(?P<shot>[1-9]\d*)|(?P<seconds>\d+(?:\.\d+)?)s|now)$")
_NUMBER = re.compile(r"^(?P<number>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(?P<unit>\D*)$")


@dataclass(frozen=True)
class FaultValue:
    """One number of a fault.

    Attributes
    ----------
    what : str
        What it is, for the list of faults.
    unit : str
        Unit in which it is written; empty for a factor.
    default : float or None
        In that unit; None if it must be given.
    low : float
        Lowest value, in that unit.
    """

    what: str
    unit: str = ""
    default: float | None = None
    low: float = -math.inf


@dataclass(frozen=True)
class FaultKind:
    """What a name stands for.

    Attributes
    ----------
    about : str
        What happens, for the list of faults.
    channel : {"", "sensor", "coil", "excitation coil"}
        What its channel names; empty if it has none.
    every : bool
        Whether the fault concerns every such channel if none is named; otherwise the first.
    values : tuple of FaultValue
    """

    about: str
    channel: str = ""
    every: bool = False
    values: tuple[FaultValue, ...] = ()


@dataclass(frozen=True)
class InjectedFault:
    """One pending fault.

    Attributes
    ----------
    name : str
    phase : str
        Phase of the shot in which it occurs; empty if a time is given, or if it occurs at once.
    shot : int
        Number of the electrical shot, from 1.
    seconds : float or None, in s
        Time after the first shot; None with an empty phase means at once.
    duration : float or None, in s
        `ONCE`, `GOOD`, or how long it lasts; None if the text does not say.
    channel : str
        Sensor, from 0, or coil by name; empty if the text names none.
    values : tuple of float
        In the units of the fault's `FaultKind`.
    text : str
        As it was written.
    """

    name: str
    phase: str = ""
    shot: int = 0
    seconds: float | None = None
    duration: float | None = None
    channel: str = ""
    values: tuple[float, ...] = ()
    text: str = ""


def parse_fault(text: str, kinds: Mapping[str, FaultKind]) -> InjectedFault:
    """Parse a fault in the command line's spelling.

    Parameters
    ----------
    text : str
        ``NAME[.CHANNEL][=VALUE[,VALUE]][@MOMENT][:LASTING]``. A moment is ``now``, ``12.5s`` (after the first shot), or
        ``before#30``, ``actuation#30`` or ``listening#30`` (of the 30th electrical shot). It lasts ``once``, for
        ``good``, or a number of seconds.
    kinds : mapping of str to FaultKind
        Known faults by name.

    Returns
    -------
    InjectedFault

    Raises
    ------
    InputError
        If name, channel, values, moment or duration are unknown.

    Examples
    --------
    >>> kinds = {"sensor_gain": FaultKind("", "sensor", values=(FaultValue("factor"),)), "overrun": FaultKind("")}
    >>> fault = parse_fault("sensor_gain.3=0.5@12.5s:4", kinds)
    >>> fault.name, fault.channel, fault.values, fault.seconds, fault.duration
    ('sensor_gain', '3', (0.5,), 12.5, 4.0)
    >>> parse_fault("overrun@actuation#30:good", kinds).shot
    30
    """
    head, _, lasting = text.partition(":")
    head, _, moment = head.partition("@")
    head, equals, value = head.partition("=")
    name, dot, channel = head.partition(".")
    if name not in kinds:
        raise InputError(
            f"--fault {text}: no fault is named '{name}'; known faults: {', '.join(kinds)}.{suggest_name(name, kinds)}"
        )
    found = _MOMENT.match(moment or "now")
    if found is None:
        raise InputError(
            f"--fault {text}: '{moment}' is no moment; use now, 12.5s (after the first shot), or before#30, "
            "actuation#30, listening#30 (of the 30th shot)."
        )
    kind = kinds[name]
    if dot and not kind.channel:
        raise InputError(f"--fault {text}: '{name}' takes no channel; got '{channel}'.")
    return InjectedFault(
        name,
        found["phase"] or "",
        int(found["shot"] or 0),
        None if found["seconds"] is None else float(found["seconds"]),
        _parse_duration(text, lasting),
        channel,
        _parse_values(text, value if equals else "", name, kind),
        text,
    )


def _parse_duration(text: str, lasting: str) -> float | None:
    known = {"": None, "once": ONCE, "good": GOOD}
    if lasting in known:
        return known[lasting]
    number = _NUMBER.match(lasting)
    if number is None or number["unit"] not in ("", "s") or not 0 < float(number["number"]) < math.inf:
        raise InputError(f"--fault {text}: lasts 'once', for 'good', or a number of seconds; got '{lasting}'.")
    return float(number["number"])


def _parse_values(text: str, value: str, name: str, kind: FaultKind) -> tuple[float, ...]:
    """Parse the values after the equals sign; those not given take their defaults."""
    parts = [part.strip() for part in value.split(",")] if value.strip() else []
    if len(parts) > len(kind.values):
        takes = describe_values(kind) or "no value"
        raise InputError(f"--fault {text}: '{name}' takes {takes}; got '{value}'.")
    found = []
    for i, wanted in enumerate(kind.values):
        if i >= len(parts):
            if wanted.default is None:
                raise InputError(f"--fault {text}: '{name}' needs {describe_values(kind)}, such as {name}=0.5.")
            found.append(wanted.default)
            continue
        number = _NUMBER.match(parts[i])
        if number is None or number["unit"] not in ("", wanted.unit) or not math.isfinite(float(number["number"])):
            unit = f" in {wanted.unit}" if wanted.unit else ""
            raise InputError(f"--fault {text}: {wanted.what} is a number{unit}; got '{parts[i]}'.")
        if float(number["number"]) < wanted.low:
            raise InputError(f"--fault {text}: {wanted.what} must be at least {wanted.low:g}; got {parts[i]}.")
        found.append(float(number["number"]))
    return tuple(found)


def describe_values(kind: FaultKind) -> str:
    """Describe the values of a kind of fault; empty if it has none.

    Parameters
    ----------
    kind : FaultKind

    Returns
    -------
    str

    Examples
    --------
    >>> describe_values(FaultKind("", values=(FaultValue("amplitude", "nT"), FaultValue("frequency", "Hz", 50.0))))
    'amplitude in nT, frequency in Hz (50 unless given)'
    """
    return ", ".join(
        value.what
        + (f" in {value.unit}" if value.unit else "")
        + ("" if value.default is None else f" ({value.default:g} unless given)")
        for value in kind.values
    )


class FaultSchedule:
    """Knows at which times of a rig's clock each fault is present.

    A fault whose duration is not given stays.

    Parameters
    ----------
    faults : sequence of InjectedFault

    Attributes
    ----------
    faults : tuple of InjectedFault
    """

    def __init__(self, faults: Sequence[InjectedFault]) -> None:
        self.faults = tuple(faults)
        self._starts = [FROM_THE_START if not f.phase and f.seconds is None else math.inf for f in faults]
        self._shots = 0

    def begin_shot(self, shot: Shot, time: float) -> None:
        """Note that a shot begins: faults of this shot, or of a time after the first one, get their start.

        Parameters
        ----------
        shot : Shot
        time : float, in s
            On the rig's clock.
        """
        if any(isinstance(window, Rotate | MoveMagnet) for window in shot.windows):
            return
        self._shots += 1
        for i, fault in enumerate(self.faults):
            if fault.seconds is not None and self._shots == 1:
                self._starts[i] = time + fault.seconds
            elif fault.phase and fault.shot == self._shots:
                self._starts[i] = time + _find_phase(shot, fault.phase)

    def find_span(self, index: int) -> tuple[float, float]:
        """Return when a fault begins and ends.

        Parameters
        ----------
        index : int
            Of the fault in `faults`.

        Returns
        -------
        start, end : float, in s
            On the rig's clock; the start is infinite while it is not known.
        """
        start, duration = self._starts[index], self.faults[index].duration
        if duration is None:
            duration = GOOD
        length = STATE_DURATION if duration == ONCE else duration
        return start, start + length

    def is_active(self, index: int, time: float) -> bool:
        """Return whether a fault is present.

        Parameters
        ----------
        index : int
            Of the fault in `faults`.
        time : float, in s

        Returns
        -------
        bool
        """
        start, end = self.find_span(index)
        return start <= time < end


def _find_phase(shot: Shot, phase: str) -> float:
    """Return the start of a phase of a shot, in s after the shot's; that of the shot itself if it has no such phase."""
    wanted = {"actuation": Actuate, "listening": Listen}.get(phase)
    return next((at for at, window in shot.timed() if wanted is not None and isinstance(window, wanted)), 0.0)
