"""A track that a camera left in the run folder is compared with the poses."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from smolbot.runs.optics.optical_track import OpticalTrack, write_optical_track
from smolbot.runs.report.optical_section import (
    FOLDER,
    TRACK,
    build_optical_sections,
    compare_with_track,
    format_optical_rows,
)
from smolbot.runs.report.recorded_flight import RecordedFlight

OFF = np.array([1e-4, 0.0, 0.0])


@pytest.fixture(scope="module")
def filmed(folder, flight, mission, tmp_path_factory):
    """The flight with a camera that sees the truth 0.1 mm too far to the right, and 2 degrees turned."""
    place = tmp_path_factory.mktemp("filmed") / "run"
    shutil.copytree(folder, place)
    truths = [m.truth for m in flight.trace.moments if m.truth is not None and m.cycle.pose is not None]
    ahead = np.array([t.body_axis("z") for t in truths])
    n = len(truths)
    track = OpticalTrack(
        np.arange(n), np.array([t.time for t in truths]), np.array([t.position for t in truths]) + OFF,
        np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0])) + np.radians(2.0), np.full(n, 1e-5), np.ones(n), n,
    )  # fmt: skip
    (place / FOLDER).mkdir()
    write_optical_track(place / FOLDER / TRACK, track)
    return RecordedFlight.read(place, mission)


def test_poses_are_compared_with_what_the_camera_saw_at_their_times(filmed):
    seen = compare_with_track(filmed)
    known = [
        (m.cycle.pose, m.truth)
        for m in filmed.trace.moments
        if m.cycle.pose is not None and m.cycle.pose.trusted and m.truth
    ]
    inside = [np.linalg.norm((p.position - t.position - OFF)[:2]) for p, t in known if p.time in seen.times]
    assert len(seen.times) >= 0.8 * len(known)
    np.testing.assert_allclose(seen.distances, inside, atol=1e-9)
    assert np.degrees(np.median(seen.heading_errors)) == pytest.approx(-2.0, abs=1.5)
    names = [row[0] for row in format_optical_rows(filmed, seen)]
    assert "robot in the video to the path, mm" in names


def test_a_run_without_a_track_has_no_such_section_and_a_broken_one_is_told(flight, filmed, tmp_path, mission):
    assert build_optical_sections(flight) == []
    assert len(build_optical_sections(filmed)) == 1
    place = tmp_path / "run"
    shutil.copytree(filmed.record.folder, place)
    (place / FOLDER / TRACK).write_text("frame,time_s\n1,2\n")
    (section,) = build_optical_sections(RecordedFlight.read(place, mission))
    assert "cannot be used" in section.body[0]
    assert "x_m" in section.body[0]
