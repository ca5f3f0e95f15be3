"""The optical reference: the tank's own camera films, and the tracker finds what it filmed; it is told nothing else."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("cv2", reason="needs the extra track")

from sim.film.command import film
from sim.film.swing import film_swing
from sim.measure.video_accuracy import compare_track, compute_rms, measure_accuracy
from smolbot.config.load import load_mission
from smolbot.config.rig import load_rig
from smolbot.config.robot import load_robot
from smolbot.errors import InputError, SmolbotError
from smolbot.flight.session import fly
from smolbot.runs.folder import RunFolder
from smolbot.runs.optics.body_fit import compute_color_distance, compute_color_weights
from smolbot.runs.optics.optical_track import OpticalTrack, read_optical_track, write_optical_track
from smolbot.ui.cli.track import track

SHORT = {"path.points_mm": "[[-6.0, 0.0], [6.0, 2.0]]", "start.offset_mm": "[-0.5, 0.3]", "localization.quiet_s": "1.0"}


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """A short flight, and its folder."""
    folder = tmp_path_factory.mktemp("filmed") / "run"
    return fly(load_mission("line", None, SHORT), 5, folder=RunFolder(folder)), folder


@pytest.fixture(scope="module")
def filmed(flown, tmp_path_factory):
    """A film of it: video, and its file of markers; a rod lies over the robot for a while."""
    video = tmp_path_factory.mktemp("film") / "clip.avi"
    begin = flown[0].begun
    hidden = [f"{begin + 2.0}..{begin + 3.0}"]
    film(flown[1], video, fps=4.0, seed=2, size="960x720", hide=hidden, truth=video.with_name("truth.csv"))
    return video, video.with_suffix(".toml")


@pytest.fixture(scope="module")
def tracked(flown, filmed, tmp_path_factory):
    out = tmp_path_factory.mktemp("tracked")
    track(filmed[0], fiducials=filmed[1], run=flown[1], out=out)
    return out, json.loads((out / "track.json").read_text())


def test_centre_and_heading_are_found_to_a_tenth_of_a_millimetre_and_two_degrees(filmed, tracked):
    found = compare_track(filmed[0].with_name("truth.csv"), tracked[0] / "track.csv", "run", 2)
    assert found.frames > 20
    assert len(found.center) >= 0.9 * found.frames
    assert compute_rms(found.center) < 0.1
    assert compute_rms(found.heading) < 2.0


def test_a_robot_as_bright_as_the_floor_is_not_taken_for_its_shadow(flown, tmp_path):
    found = measure_accuracy(flown[1], 21, tmp_path, fps=0.75)  # a camera to which the housing differs in blue alone
    assert len(found.center) >= 0.9 * found.frames
    assert found.center.max() < 0.5  # the shadow lies 6 mm away
    assert compute_rms(found.center) < 0.1
    assert compute_rms(found.heading) < 2.0


def test_weaker_light_counts_little_where_a_body_has_a_colour_and_fully_where_it_has_none():
    light = np.array([160.0, 165.0, 175.0])
    yellow, dark = np.array([-30.0, -4.0, 2.0]), -0.6 * light
    for tone in (yellow, dark):
        assert compute_color_weights(tone, light) @ tone == pytest.approx(1.0)
    shadow = -0.15 * light
    assert abs(compute_color_weights(yellow, light) @ shadow) < 0.1  # by brightness alone it would be 0.8
    assert compute_color_weights(dark, light) @ shadow == pytest.approx(0.25, rel=1e-6)
    assert compute_color_distance(yellow, light) > 3.0 > compute_color_distance(shadow, light)
    assert compute_color_distance(dark, light) > 3.0


def test_frames_in_which_the_robot_is_hidden_are_counted_and_left_out(tracked):
    out, figures = tracked
    found = read_optical_track(out / "track.csv")
    assert len(found.frames) == figures["frames"] - figures["hidden"]
    assert not set(range(8, 12)) & set(found.frames.tolist())  # from 2 to 3 s, 4 frames a second
    assert len(found.frames) > 0.6 * figures["frames"]


def test_a_video_is_aligned_with_its_run(flown, tracked):
    assert tracked[1]["offset_s"] == pytest.approx(flown[0].cycles[0].shot.start, abs=0.1)  # a frame lasts 0.25 s
    assert tracked[1]["correlation"] > 0.99


def test_a_runs_errors_against_the_camera_are_those_against_the_truth(flown, tracked):
    run, figures = flown[0], tracked[1]
    truth = run.summary["tracking_error_mm"]["mean"]
    assert figures["tracking_error_mm"]["mean"] == pytest.approx(truth, abs=0.1)
    assert figures["position_error_mm"]["mean"] < run.summary["localization_error_mm"]["mean"] + 0.1


def test_four_points_in_place_of_markers_do_too(flown, filmed, tracked, tmp_path):
    from smolbot.runs.optics.fiducials import find_view_by_markers, read_fiducials
    from smolbot.runs.optics.video import Video

    view = find_view_by_markers(Video(filmed[0]).background, read_fiducials(filmed[1])).view
    points = np.array([[-18.0, -18.0, 60.0], [18.0, -18.0, 60.0], [18.0, 18.0, 60.0], [-18.0, 18.0, 60.0]])
    pixels = view.project(1e-3 * points)
    spelled = " ".join(f"{u:.2f},{v:.2f}" for u, v in pixels)
    track(
        filmed[0], corners=spelled, corners_mm="-18,-18 18,-18 18,18 -18,18", corners_z_mm=60.0, run=flown[1],
        out=tmp_path / "four",
    )  # fmt: skip
    one = read_optical_track(tmp_path / "four" / "track.csv")
    other = read_optical_track(tracked[0] / "track.csv")
    assert np.abs(one.positions[:, :2] - other.positions[:, :2]).max() < 2e-4


def test_a_track_is_read_as_it_was_written(tmp_path):
    rng = np.random.default_rng(1)
    track_ = OpticalTrack(
        np.arange(5), 0.04 * np.arange(5), rng.normal(size=(5, 3)), rng.normal(size=5), np.full(5, 1e-5), np.ones(5), 7
    )
    write_optical_track(tmp_path / "track.csv", track_)
    again = read_optical_track(tmp_path / "track.csv")
    assert again.positions == pytest.approx(track_.positions, rel=1e-8)
    assert again.headings == pytest.approx(track_.headings, rel=1e-8)


@pytest.mark.slow
def test_a_swing_is_measured_from_a_high_speed_clip(tmp_path):
    rig, robot = load_rig("tank"), load_robot("gradient")
    clip, truth = tmp_path / "swing.avi", tmp_path / "truth.csv"
    made = film_swing(rig, robot, clip, seed=3, fps=5000.0)
    made.write_truth(truth)
    track(clip, deflection=True, fps=5000.0, out=tmp_path / "out")
    figures = json.loads((tmp_path / "out" / "swing.json").read_text())
    with truth.open() as file:
        angles = np.degrees([float(row["angle_rad"]) for row in csv.DictReader(file)])
    assert figures["frequency_hz"]["value"] == pytest.approx(made.frequency, rel=0.01)
    assert figures["largest_deg"] == pytest.approx(np.abs(angles).max(), rel=0.05)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "The camera's view must be known"),
        ({"corners": "1,2 3,4 5,6"}, "--corners-mm belong together|four"),
        ({"corners": "1,2 3,4 5,6", "corners_mm": "0,0 1,0 1,1 0,1"}, "four"),
        ({"corners": "0,0 100,100 200,200 300,300", "corners_mm": "0,0 1,1 2,2 3,3"}, "line"),
        ({"corners": "0,0 a,0 1,1 0,1", "corners_mm": "0,0 1,0 1,1 0,1"}, "--corners"),
        ({"fps": 0.0, "corners": "0,0 900,0 900,900 0,900", "corners_mm": "0,0 1,0 1,1 0,1"}, "fps"),
    ],
)
def test_what_cannot_be_used_is_told(filmed, options, message, tmp_path):
    with pytest.raises(InputError, match=message):
        track(filmed[0], out=tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()


def test_a_robot_that_rests_for_too_long_is_told_of():
    resting = OpticalTrack(
        np.arange(100), 0.04 * np.arange(100), np.zeros((100, 3)), np.zeros(100), np.zeros(100), np.ones(100), 200
    )
    assert resting.compute_max_still_share(1e-3) == 0.5
    going = replace(resting, positions=1e-3 * np.outer(np.arange(100), [1.0, 0.0, 0.0]))
    assert going.compute_max_still_share(1.5e-3) < 0.02


def test_a_video_without_markers_says_how_many_were_found(filmed, tmp_path):
    import cv2

    writer = cv2.VideoWriter(str(tmp_path / "bare.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 10.0, (320, 240))
    for grey in range(100, 140):
        writer.write(np.full((240, 320, 3), grey, np.uint8))
    writer.release()
    with pytest.raises(InputError, match=r"[0-3] of 8"):
        track(tmp_path / "bare.avi", fiducials=filmed[1], out=tmp_path / "out")


@pytest.mark.parametrize("content", [b"", b"this is no video\n" * 100])
def test_a_file_that_is_no_video_is_told(filmed, tmp_path, content):
    (tmp_path / "no.avi").write_bytes(content)
    with pytest.raises(InputError, match=r"no\.avi"):
        track(tmp_path / "no.avi", fiducials=filmed[1], out=tmp_path / "out")


def test_a_run_that_does_not_overlap_in_time_is_told(flown, filmed, tmp_path):
    with pytest.raises(SmolbotError):
        track(filmed[0], fiducials=filmed[1], run=flown[1], offset_s=1000.0, out=tmp_path / "out")
