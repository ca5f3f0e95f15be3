"""Convert between smolbot's objects and the messages of a record; each pair of functions is exact both ways."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.sensing import Recording
from smolbot.core.shots import Actuate, Excite, Listen, MoveMagnet, Rest, RingDown, Rotate, Shot, Window
from smolbot.motion.controller import Command
from smolbot.runs.recording import run_pb2 as pb
from smolbot.runs.recording.converter import Converter
from smolbot.runs.run import Event

FORMAT = 1

TOPICS: dict[str, Any] = {
    "/run/begin": pb.Begin,
    "/shots": pb.Shot,
    "/windows": pb.Samples,
    "/poses/raw": pb.Pose,
    "/poses/tracked": pb.Pose,
    "/poses/true": pb.Truth,
    "/commands": pb.Command,
    "/timing": pb.Timing,
    "/events": pb.Event,
    "/run/dropped": pb.Dropped,
    "/run/recovered": pb.Recovered,
    "/run/end": pb.End,
}
"""Topics of a record, and the type of their messages."""


def encode_window(window: Window) -> pb.Window:
    """Convert a window of a shot to a message.

    Parameters
    ----------
    window : Window

    Returns
    -------
    pb.Window
    """
    match window:
        case Actuate(currents, duration):
            return pb.Window(actuate=pb.Window.Actuate(currents=currents, duration=duration))
        case Excite((x, y), frequency, cycles):
            return pb.Window(excite=pb.Window.Excite(x=x, y=y, frequency=frequency, cycles=cycles))
        case RingDown(duration):
            return pb.Window(ring_down=pb.Window.RingDown(duration=duration))
        case Listen(half_periods, frequency):
            return pb.Window(listen=pb.Window.Listen(half_periods=half_periods, frequency=frequency))
        case Rest(duration):
            return pb.Window(rest=pb.Window.Rest(duration=duration))
        case Rotate((x, y, z), frequency, turns):
            return pb.Window(rotate=pb.Window.Rotate(x=x, y=y, z=z, frequency=frequency, turns=turns))
        case MoveMagnet(to, duration):
            return pb.Window(move_magnet=pb.Window.MoveMagnet(near=to == "near", expected_duration=duration))


def decode_window(message: pb.Window) -> Window:
    """Convert a message to a window of a shot.

    Parameters
    ----------
    message : pb.Window

    Returns
    -------
    Window

    Raises
    ------
    ValueError
        For an unknown kind.
    """
    match message.WhichOneof("kind"):
        case "actuate":
            return Actuate(tuple(message.actuate.currents), message.actuate.duration)
        case "excite":
            excite = message.excite
            return Excite((excite.x, excite.y), excite.frequency, excite.cycles)
        case "ring_down":
            return RingDown(message.ring_down.duration)
        case "listen":
            return Listen(message.listen.half_periods, message.listen.frequency)
        case "rest":
            return Rest(message.rest.duration)
        case "rotate":
            rotate = message.rotate
            return Rotate((rotate.x, rotate.y, rotate.z), rotate.frequency, rotate.turns)
        case "move_magnet":
            return MoveMagnet("near" if message.move_magnet.near else "away", message.move_magnet.expected_duration)
        case kind:
            raise ValueError(f"window of an unknown kind: {kind}")


def encode_shot(number: int, shot: Shot, ended: float, *, has_samples: bool) -> pb.Shot:
    """Convert a played shot to a message.

    Parameters
    ----------
    number : int
        Number of the shot.
    shot : Shot
    ended : float, in s
        When the shot ended, on the rig's clock.
    has_samples : bool
        Whether there are samples of it.

    Returns
    -------
    pb.Shot
    """
    windows = [encode_window(window) for window in shot.windows]
    return pb.Shot(number=number, mode=shot.mode, start=shot.start, ended=ended, windows=windows, heard=has_samples)


def decode_shot(message: pb.Shot) -> Shot:
    """Convert a message to a shot.

    Parameters
    ----------
    message : pb.Shot

    Returns
    -------
    Shot
    """
    return Shot(tuple(decode_window(w) for w in message.windows), message.mode, message.start)  # type: ignore[arg-type]


def encode_samples(number: int, recording: Recording, converter: Converter) -> pb.Samples:
    """Convert a recording to a message.

    Parameters
    ----------
    number : int
        Number of the shot.
    recording : Recording
    converter : Converter

    Returns
    -------
    pb.Samples
    """
    scaling, counts = converter.counts(recording.field)
    message = pb.Samples(
        number=number,
        clock=recording.clock,
        sample_rate=recording.sample_rate,
        time_since_drive=recording.time_since_drive,
        sensors=len(recording.field),
        saturated=np.flatnonzero(recording.saturated).tolist(),
        scaling=scaling,  # type: ignore[arg-type]
    )
    if counts is not None:
        message.counts = counts.astype("<i2").tobytes()
    else:
        message.field = recording.field.astype("<f8").tobytes()
    return message


def decode_recording(message: pb.Samples, converter: Converter, shot: Shot) -> Recording:
    """Convert a message to a recording.

    Parameters
    ----------
    message : pb.Samples
    converter : Converter
    shot : Shot
        In which it was recorded.

    Returns
    -------
    Recording
    """
    shape = (message.sensors, -1)
    if message.scaling == pb.Samples.FIELD:
        field = np.frombuffer(message.field, "<f8").astype(float).reshape(shape)
    else:
        counts = np.frombuffer(message.counts, "<i2").reshape(shape)
        field = converter.field(int(message.scaling), counts)
    saturated = np.zeros(message.sensors, np.bool_)
    saturated[list(message.saturated)] = True
    return Recording(field, message.sample_rate, message.time_since_drive, saturated, shot.excite, clock=message.clock)


def encode_pose(number: int, pose: Pose) -> pb.Pose:
    """Convert a pose to a message.

    Parameters
    ----------
    number : int
        Number of the cycle.
    pose : Pose

    Returns
    -------
    pb.Pose
    """
    return pb.Pose(
        number=number,
        time=pose.time,
        position=pose.position,
        orientation=pose.orientation,
        covariance=pose.covariance.ravel(),
        r_squared=pose.r_squared,
        flip_margin=pose.flip_margin,
        trusted=pose.trusted,
    )


def decode_pose(message: pb.Pose) -> Pose:
    """Convert a message to a pose.

    Parameters
    ----------
    message : pb.Pose

    Returns
    -------
    Pose
    """
    pose = Pose(
        message.time,
        np.array(message.position),
        np.array(message.orientation),
        np.array(message.covariance).reshape(6, 6),
        message.r_squared,
        message.flip_margin,
        message.trusted,
    )
    orientation = np.array(message.orientation)
    orientation.setflags(write=False)
    object.__setattr__(pose, "orientation", orientation)  # to make it a unit once more could change its last bit
    return pose


def encode_truth(number: int, truth: Pose | None, end: Pose | None, way: FloatArray) -> pb.Truth:
    """Convert the ground truth during a cycle to a message.

    Parameters
    ----------
    number : int
        Number of the cycle.
    truth : Pose or None
        At the time of the pose.
    end : Pose or None
        At the end of the shot.
    way : ndarray, shape (n, 3), in m
        True positions in the world frame during a shot without listening.

    Returns
    -------
    pb.Truth
    """
    return pb.Truth(
        number=number,
        pose=None if truth is None else encode_pose(number, truth),
        end=None if end is None else encode_pose(number, end),
        way=way.ravel(),
    )


def encode_command(number: int, command: Command) -> pb.Command:
    """Convert a command to a message.

    Parameters
    ----------
    number : int
        Number of the cycle before it.
    command : Command

    Returns
    -------
    pb.Command
    """
    window = command.window
    several = isinstance(window, tuple)
    windows: Iterable[Window] = () if window is None else window if isinstance(window, tuple) else (window,)
    return pb.Command(
        number=number,
        windows=[encode_window(w) for w in windows],
        several=several,
        saturated=command.saturated,
        note=command.note,
        progress=command.progress,
        phase=command.phase,
        done=command.done,
        stuck=command.stuck,
        event=command.event,
    )


def decode_command(message: pb.Command) -> Command:
    """Convert a message to a command.

    Parameters
    ----------
    message : pb.Command

    Returns
    -------
    Command
    """
    windows = tuple(decode_window(w) for w in message.windows)
    window: Any = windows if message.several else windows[0] if windows else None
    return Command(
        window,
        message.saturated,
        message.note,
        message.progress,
        message.phase,  # type: ignore[arg-type]
        message.done,
        message.stuck,
        message.event,
    )


def encode_event(event: Event) -> pb.Event:
    """Convert an event to a message.

    Parameters
    ----------
    event : Event

    Returns
    -------
    pb.Event
    """
    return pb.Event(time=event.time, what=event.what, detail=json.dumps(event.detail, default=_to_plain))


def _to_plain(value: Any) -> Any:
    """Convert a value that JSON does not know: numbers and arrays of numpy to lists and numbers, others to text."""
    return value.tolist() if hasattr(value, "tolist") else str(value)


def decode_event(message: pb.Event) -> Event:
    """Convert a message to an event.

    Parameters
    ----------
    message : pb.Event

    Returns
    -------
    Event
    """
    return Event(message.time, message.what, json.loads(message.detail))


def encode_converter(converter: Converter) -> pb.Converter:
    """Convert a converter's description to a message.

    Parameters
    ----------
    converter : Converter

    Returns
    -------
    pb.Converter
    """
    return pb.Converter(
        bits=converter.bits,
        range=converter.range,
        volts_per_tesla=converter.volts_per_tesla,
        gains=converter.gains,
    )


def decode_converter(message: pb.Converter) -> Converter:
    """Convert a message to a converter's description.

    Parameters
    ----------
    message : pb.Converter

    Returns
    -------
    Converter
    """
    return Converter(message.bits, message.range, message.volts_per_tesla, np.array(message.gains))
