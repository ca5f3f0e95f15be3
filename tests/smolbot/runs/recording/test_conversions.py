"""What goes into a record comes out of it to the last bit."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smolbot.core.pose import Pose
from smolbot.core.sensing import Recording
from smolbot.core.shots import Actuate, Excite, Listen, MoveMagnet, Rest, RingDown, Rotate, Shot, Window
from smolbot.motion.controller import Command
from smolbot.runs.recording import messages
from smolbot.runs.recording import run_pb2 as pb
from smolbot.runs.recording.converter import BOTH, FIELD, TESLA, VOLTS, Converter
from smolbot.runs.run import Event

any_float = st.floats(allow_nan=True, allow_infinity=True)
finite = st.floats(allow_nan=False, allow_infinity=False, width=64)
time_ = st.floats(0.0, 1e6)
windows = st.one_of(
    st.builds(Actuate, st.lists(finite, min_size=1, max_size=8).map(tuple), finite),
    st.builds(Excite, st.tuples(finite, finite), finite, st.integers(0, 1000)),
    st.builds(RingDown, finite),
    st.builds(Listen, st.integers(0, 10_000), finite),
    st.builds(Rest, finite),
    st.builds(Rotate, st.tuples(finite, finite, finite), finite, finite),
    st.builds(MoveMagnet, st.sampled_from(["near", "away"]), finite),
)


def through(message):
    """As it is read again from a file."""
    return type(message).FromString(message.SerializeToString())


def bits(value):
    return np.asarray(value, float).tobytes()


@given(windows)
def test_windows(window):
    again = messages.decode_window(through(messages.encode_window(window)))
    assert again == window
    assert repr(again) == repr(window)


def test_every_kind_of_window_has_a_message_and_none_is_left_over():
    kinds = {field.name for field in pb.Window.DESCRIPTOR.oneofs_by_name["kind"].fields}
    made = {
        messages.encode_window(w).WhichOneof("kind")
        for w in (
            *(Actuate((1.0,), 1.0), Excite((1.0, 0.0), 1.0, 1), RingDown(1.0), Listen(1, 1.0), Rest(1.0)),
            *(Rotate((1.0, 0.0, 0.0), 1.0, 1.0), MoveMagnet("near", 1.0)),
        )
    }
    assert made == kinds
    assert len(get_args(Window)) == len(kinds)
    with pytest.raises(ValueError, match="unknown kind"):
        messages.decode_window(pb.Window())


@given(
    st.lists(any_float, min_size=6, max_size=6),
    st.tuples(*[st.floats(-1e3, 1e3)] * 3),
    st.integers(0, 2**32),
    time_,
    any_float,
)
def test_poses_with_any_covariance(covariance, position, seed, time, r_squared):
    orientation = np.random.default_rng(seed).normal(size=4)
    orientation /= np.linalg.norm(orientation)
    pose = Pose(time, np.array(position), orientation, np.tile(covariance, (6, 1)), r_squared, 1.5, False)
    again = messages.decode_pose(through(messages.encode_pose(7, pose)))
    for name in ("position", "orientation", "covariance", "rotation"):
        assert bits(getattr(again, name)) == bits(getattr(pose, name)), name
    assert (again.time, again.flip_margin, again.trusted) == (pose.time, pose.flip_margin, pose.trusted)
    assert bits(again.r_squared) == bits(pose.r_squared)
    assert not again.position.flags.writeable


@given(
    st.one_of(st.none(), windows, st.lists(windows, max_size=3).map(tuple)), st.booleans(), st.text(), finite,
    st.sampled_from(["search", "approach", "follow", "done"]), st.booleans(), st.booleans(), st.text(),
)  # fmt: skip
def test_commands(window, saturated, note, progress, phase, done, stuck, event):
    command = Command(window, saturated, note, progress, phase, done, stuck, event)
    assert messages.decode_command(through(messages.encode_command(3, command))) == command


json_like = st.recursive(
    st.none() | st.booleans() | st.integers() | finite | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@given(time_, st.text(), st.dictionaries(st.text(), json_like, max_size=4))
def test_events(time, what, detail):
    assert messages.decode_event(through(messages.encode_event(Event(time, what, detail)))) == Event(time, what, detail)


def test_numbers_of_numpy_in_an_event_stay_numbers():
    event = Event(1.0, "x", {"count": np.int64(3), "value": np.float64(0.1), "list": np.array([1.5, 2.5])})
    assert messages.decode_event(messages.encode_event(event)).detail == {"count": 3, "value": 0.1, "list": [1.5, 2.5]}


@given(st.lists(windows, min_size=1, max_size=4), time_, time_, st.booleans())
def test_shots(parts, start, ended, heard):
    message = pb.Shot(number=2, mode="track", start=start, ended=ended, heard=heard)
    message.windows.extend(messages.encode_window(w) for w in parts)
    again = through(message)
    assert tuple(messages.decode_window(w) for w in again.windows) == tuple(parts)
    shot = Shot((Listen(2, 100.0),), "hold", start)
    told = through(messages.encode_shot(5, shot, ended, has_samples=heard))
    assert messages.decode_shot(told) == shot
    assert (told.number, told.ended, told.heard) == (5, ended, heard)


GAINS = np.array([1.0, 0.97, 1.031, -1.0])
converters = st.builds(
    Converter,
    st.integers(8, 16),
    st.sampled_from([10.0, 5.0, 2.5, 1.0]),
    st.sampled_from([5e4, 4.7e4, 2e5 / 3]),
    st.just(GAINS),
)


@given(converters, st.sampled_from([TESLA, VOLTS, BOTH]), st.integers(0, 2**32))
def test_counts_are_found_again_whichever_way_they_became_a_field(converter, scaling, seed):
    counts = np.random.default_rng(seed).integers(-(2**15), 2**15, (4, 50)).astype(np.int16)
    counts[:, :3] = [-(2**15), 2**15 - 1, 0]
    field = converter.field(scaling, counts)
    found, again = converter.counts(field)
    assert found != FIELD
    assert again.tobytes() == counts.tobytes()
    assert converter.field(found, again).tobytes() == field.tobytes()


@given(converters, st.integers(0, 2**32), st.sampled_from([0.5, math.nan, math.inf, -0.0, 2.0**15, -(2.0**15) - 1]))
def test_what_16_bits_cannot_hold_is_kept_as_it_is(converter, seed, odd):
    counts = np.random.default_rng(seed).integers(-1000, 1000, (4, 20)).astype(np.int16)
    field = converter.field(TESLA, counts)
    field[1, 3] = odd if not math.isfinite(odd) or odd == 0.0 else converter._tesla * odd / GAINS[1]
    assert converter.counts(field)[0] == FIELD
    shot = Shot((Listen(2, 100.0),), "track", 1.0)
    recording = Recording(field, 5e4, math.inf, np.array([True, False, False, True]), None, 1.5)
    again = messages.decode_recording(through(messages.encode_samples(4, recording, converter)), converter, shot)
    assert again.field.tobytes() == field.tobytes()
    assert (again.sample_rate, again.time_since_drive, again.clock, again.drive) == (5e4, math.inf, 1.5, None)
    assert list(again.saturated) == [True, False, False, True]


@given(converters)
def test_a_recording_in_counts_is_a_quarter_of_its_size_and_the_same(converter):
    counts = np.arange(4 * 30).reshape(4, 30).astype(np.int16)
    shot = Shot((Excite((1.0, 0.0), 100.0, 3), RingDown(0.01), Listen(2, 100.0)), "track", 1.0)
    recording = Recording(converter.field(VOLTS, counts), 5e4, 0.01, drive=shot.excite, clock=1.5)
    message = messages.encode_samples(4, recording, converter)
    assert len(message.counts) == recording.field.nbytes // 4
    told = messages.decode_converter(through(messages.encode_converter(converter)))
    again = messages.decode_recording(through(message), told, shot)
    assert again.field.tobytes() == recording.field.tobytes()
    assert again.drive == shot.excite


@pytest.mark.parametrize("shape", [(4, 0), (3, 10)])
def test_recordings_without_samples_or_of_another_array_are_kept_as_they_are(shape):
    converter = Converter(16, 10.0, 5e4, GAINS)
    recording = Recording(np.ones(shape), 5e4, 0.01)
    message = messages.encode_samples(0, recording, converter)
    again = messages.decode_recording(message, converter, Shot((Listen(2, 100.0),), "track", 1.0))
    assert again.field.shape == shape
    assert again.field.tobytes() == recording.field.tobytes()


@given(st.lists(st.tuples(finite, finite, finite), max_size=4))
def test_ways_of_a_truth(way):
    told = through(messages.encode_truth(1, None, None, np.array(way, float).reshape(-1, 3)))
    assert bits(np.array(told.way).reshape(-1, 3)) == bits(np.array(way, float).reshape(-1, 3))
    assert not told.HasField("pose")


def test_the_generated_messages_are_those_that_the_description_makes(tmp_path):
    pytest.importorskip("grpc_tools")
    root = Path(messages.__file__).parents[3]
    where = f"--python_out={tmp_path}", f"--pyi_out={tmp_path}"
    order = [sys.executable, "-m", "grpc_tools.protoc", "-I.", *where, "smolbot/runs/recording/run.proto"]
    subprocess.run(order, cwd=root, check=True)
    for name in ("run_pb2.py", "run_pb2.pyi"):
        made = (tmp_path / "smolbot" / "runs" / "recording" / name).read_text()
        assert made == (root / "smolbot" / "runs" / "recording" / name).read_text(), f"{name}: run make proto"
