"""The page of a run is whole in itself, says what the summary says, and comes of a record that was cut short too."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from copy import copy, deepcopy
from dataclasses import replace
from html.parser import HTMLParser

import pytest

from smolbot.config.mission import load_steering_mission
from smolbot.errors import InputError
from smolbot.flight.session import fly
from smolbot.runs.folder import RunFolder
from smolbot.runs.report import comparison_page as comparisonpage
from smolbot.runs.report import page as report
from smolbot.runs.report.animation import make_animation
from smolbot.runs.report.comparison import _check_same_kind, compare
from smolbot.runs.report.comparison_page import build_comparison_page
from smolbot.runs.report.page import REPORT, build_report, save_report
from smolbot.runs.report.recorded_flight import NO_TRUTH, RecordedFlight
from smolbot.runs.report.setting_differences import find_changes, flatten
from smolbot.ui.cli.app import main

ANCHORS = {"verdict", "path", "errors", "budget", "coils", "cycle", "fit", "noise", "events", "provenance"}
VOID = {"meta", "br", "hr", "img", "link", "input"}


class Page(HTMLParser):
    """Reads a page strictly: every element that opens must close, in order."""

    def __init__(self, text):
        super().__init__()
        self.open, self.sections, self.links, self.outside, self.figures, self.values = [], set(), [], [], 0, []
        self._ids = set()
        self.feed(text)
        self.close()
        assert not self.open, f"never closed: {self.open}"

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        if tag not in VOID:
            self.open.append(tag)
        if tag == "section":
            self.sections.add(given["id"])
        self.figures += tag == "svg"
        for name, value in given.items():
            if name in ("src", "href", "data", "action", "srcset", "poster", "xlink:href"):
                (self.links if (value or "").startswith("#") else self.outside).append(value)
            if name == "style" and re.search(r"url\((?!#)", value or ""):
                self.outside.append(value)
            if name == "id":
                assert value not in self._ids, f"twice: {value}"
                self._ids.add(value)
        if tag == "data":
            self.values.append((given["data-key"], given["value"]))
        assert tag not in ("script", "iframe", "object", "embed", "link", "base")

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        if tag not in VOID:
            self.handle_endtag(tag)

    def handle_endtag(self, tag):
        assert self.open, f"{tag} closes nothing"
        assert self.open.pop() == tag

    def dangling(self):
        """Links within the page that lead nowhere."""
        return [link for link in self.links if link[1:] not in self._ids]


@pytest.fixture(scope="module")
def text(flight):
    return build_report(flight)


@pytest.fixture(scope="module")
def page(text):
    return Page(text)


def test_the_page_needs_no_other_file(page, text):
    assert page.outside == []
    assert page.dangling() == []
    style = re.search(r"<style>(.*?)</style>", text, re.S).group(1)
    assert "@import" not in style
    assert "url(" not in style
    assert "http" not in re.sub(r"<pre>.*?</pre>", "", text, flags=re.S)


def test_every_part_is_there_and_no_figure_is_heavy(page, text):
    assert page.sections >= ANCHORS
    assert page.figures >= 7
    assert len(text) < 3e6
    for line in ("How to read this", "mismatch", "@media print", "prefers-color-scheme: dark"):
        assert line in text


def test_every_number_of_the_verdict_is_the_summarys(page, folder):
    summary = json.loads((folder / "summary.json").read_text())
    assert {"tracking_error_mm.mean", "localization_error_mm.mean", "status"} <= {key for key, _ in page.values}
    for key, value in page.values:
        found = summary
        for part in key.split("."):
            found = found[int(part)] if isinstance(found, list) else found[part]
        assert value == str(found), key


def test_figures_from_the_record_are_those_of_the_flight(flight, folder):
    told = json.loads((folder / "summary.json").read_text())
    told.pop("recording")
    assert json.loads(json.dumps({**flight.summary, "run": told["run"]}, default=str)) == told


def test_provenance_holds_files_seed_and_packages(text, flight):
    for word in (
        flight.record.provenance["smolbot"],
        "numpy",
        "mission.toml",
        "rig.toml",
        "robot.toml",
        "--set path.points_mm",
    ):
        assert word in text


@pytest.mark.parametrize("share", [0.35, 0.8])
def test_a_record_that_was_cut_short_is_reported_and_headed_so(folder, tmp_path, mission, share):
    whole = (folder / "run.mcap").read_bytes()
    (tmp_path / "run.mcap").write_bytes(whole[: int(share * len(whole))])
    cut = RecordedFlight.read(tmp_path, mission)
    text = build_report(cut)
    Page(text)
    assert "This record is cut short" in text
    assert len(cut.run.cycles) < 200
    assert cut.summary["status"] == "failed"


def test_without_a_witness_the_page_says_what_it_cannot_say(mission, tmp_path):
    settings = {
        "path.points_mm": "[[-1.0, 0.0], [0.0, 0.0]]",
        "start.offset_mm": "[-0.2, 0.1]",
        "localization.quiet_s": "1.0",
    }
    blind = load_steering_mission("line", settings=settings)
    fly(blind, 3, folder=RunFolder(tmp_path / "run"), witness=False)
    flight = RecordedFlight.read(tmp_path / "run", blind)
    assert not flight.knows_truth
    text = build_report(flight)
    page = Page(text)
    assert page.sections >= ANCHORS
    assert NO_TRUTH in text
    assert "not known: no ground truth" in text
    assert "tracking_error_mm.mean" not in {key for key, _ in page.values}


def test_a_report_that_fails_costs_the_report_alone(tmp_path, monkeypatch):
    brief = load_steering_mission("line", settings={"stop.max_duration_s": "0.5", "localization.estimator": "paper"})

    def broken(*_):
        raise RuntimeError("no ink")

    monkeypatch.setattr(report, "build_report", broken)
    run = fly(brief, 3, folder=RunFolder(tmp_path / "run"), report=True)
    assert run.status == "timeout"
    assert run.report == "could not be written: RuntimeError: no ink"
    assert (tmp_path / "run" / "summary.json").is_file()
    assert not (tmp_path / "run" / REPORT).exists()


def test_flying_loads_no_matplotlib():
    modules = "smolbot.flight.session, smolbot.runs.report.page, smolbot.ui.cli.report"
    code = f"import sys, {modules}; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == 0


def test_the_page_goes_where_it_is_asked_to(flight, tmp_path, monkeypatch):
    monkeypatch.setattr(report, "build_report", lambda _: "page")
    assert save_report(flight, tmp_path / "own.html") == tmp_path / "own.html"
    with pytest.raises(InputError, match=r"nowhere.*cannot be written"):
        save_report(flight, tmp_path / "nowhere" / "own.html")


def test_foreign_files_give_one_clear_error(tmp_path, folder):
    (tmp_path / "picture.mcap").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    with pytest.raises(InputError, match="is no MCAP file"):
        RecordedFlight.read(tmp_path / "picture.mcap")
    (tmp_path / "short.mcap").write_bytes((folder / "run.mcap").read_bytes()[:40])
    with pytest.raises(InputError, match="cut short"):
        RecordedFlight.read(tmp_path / "short.mcap")


@pytest.fixture(scope="module")
def other(tmp_path_factory):
    """The same path a little further on, with another gain."""
    settings = {"path.points_mm": "[[-1.0, 0.0], [1.0, 0.5]]", "start.offset_mm": "[-0.2, 0.1]",
                "localization.quiet_s": "2.0", "controller.gains.spacing_mm": "1.0"}  # fmt: skip
    path = tmp_path_factory.mktemp("compared") / "other"
    fly(load_steering_mission("line", settings=settings), 4, folder=RunFolder(path), settings=settings)
    return path


def test_compared_runs_say_what_was_changed_and_by_how_much_they_differ(folder, other):
    found = compare([folder, other])
    settings = dict(found.settings)
    assert settings["mission.controller.gains.spacing_mm"] == ["1.5", "1.0"]
    assert settings["seed"] == ["3", "4"]
    assert "mission.controller.gains.i_max_a" not in settings
    assert any("different paths" in note for note in found.notes)
    figure = next(f for f in found.figures if f.key == "tracking_error_mm.mean")
    means = [json.loads((run / "summary.json").read_text())["tracking_error_mm"]["mean"] for run in (folder, other)]
    assert [e.value for e in figure.values] == pytest.approx(means)
    assert figure.differences_to_first[1].value == pytest.approx(means[1] - means[0])
    page = Page(build_comparison_page(found))
    assert page.outside == []
    assert page.dangling() == []
    json.dumps(found.as_dict())


def test_a_run_compared_with_itself_differs_in_nothing(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "again")
    found = compare([folder, tmp_path / "again"])
    assert found.settings == []
    assert all(f.differences_to_first[1].value == 0.0 for f in found.figures)


def test_an_untouched_copy_of_a_file_is_no_change_and_another_content_is(flight):
    """A run of `init`'s copies names other files that hold the same."""
    copied, drawn = (deepcopy(flight.record.begin) for _ in range(2))
    mission = copied.files["mission.toml"]
    copied.files["mission.toml"] = mission.replace(b'robot = "gradient"', b'robot = "mine/robot.toml"')
    assert copied.files["mission.toml"] != mission
    copied.names["path.file"], copied.files["path.svg"] = "path.svg", b"<svg/>"
    drawn.names["path.file"], drawn.files["path.svg"] = "path.svg", b"<svg />"
    same, other = (replace(flight, record=replace(flight.record, begin=begin)) for begin in (copied, drawn))
    assert [name for name, _ in find_changes([same, other])] == ["mission.path.file"]


def test_runs_of_different_robots_are_not_compared(folder, tmp_path):
    from smolbot.config.observation import load_observation

    seen = load_observation("brain_marker", settings={"observe.measurements": "2", "localization.quiet_s": "1.0"})
    fly(seen, 1, folder=RunFolder(tmp_path / "marker"))
    with pytest.raises(InputError, match=r"run steered \('line'\).*marker only observed \('brain_marker'\)"):
        compare([folder, tmp_path / "marker"])
    text = build_report(RecordedFlight.read(tmp_path / "marker", seen))
    assert Page(text).sections >= ANCHORS - {"errors"}


def test_another_robot_of_the_same_kind_is_another_robot(flight):
    foreign = copy(flight.mission)
    foreign.robot = copy(foreign.robot)
    foreign.robot.name = "another"
    with pytest.raises(InputError, match=r"'gradient' \(gradient\).*'another' \(gradient\)"):
        _check_same_kind([flight, replace(flight, mission=foreign)])


def test_an_animation_has_its_length_and_says_its_speed(folder, tmp_path):
    from PIL import Image

    made = make_animation(folder, tmp_path / "run.gif", seconds=1.0, fps=5)
    with Image.open(tmp_path / "run.gif") as shown:
        assert shown.n_frames == 5
        first = shown.convert("RGB").tobytes()
        shown.seek(4)
        assert shown.convert("RGB").tobytes() != first
    assert made.size == (tmp_path / "run.gif").stat().st_size < 200_000
    with pytest.raises(InputError, match=r"one of \.gif, \.mp4"):
        make_animation(folder, tmp_path / "run.avi")


def test_an_mp4_without_ffmpeg_is_one_clear_error(folder, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", "")
    with pytest.raises(InputError, match="needs ffmpeg"):
        make_animation(folder, tmp_path / "run.mp4")


def test_settings_are_flattened_with_their_places():
    assert flatten({"coils": [{"name": "a"}, {"name": "b"}], "x": [1, 2]}, "rig") == {
        "rig.coils.0.name": '"a"',
        "rig.coils.1.name": '"b"',
        "rig.x": "[1, 2]",
    }


def said(capsys, monkeypatch, *words):
    """Exit code, standard output and standard error of the command line, in this process."""
    monkeypatch.setattr(sys, "argv", ["smolbot", "report", *map(str, words)])
    with pytest.raises(SystemExit) as end:
        main()
    out, err = capsys.readouterr()
    return end.value.code, out, err


def test_the_command_writes_pages_and_speaks_json(folder, other, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(report, "build_report", lambda _: "page")
    code, out, _ = said(capsys, monkeypatch, folder, "--out", tmp_path / "one.html", "--json")
    assert code == 0
    assert json.loads(out)["report"] == str(tmp_path / "one.html")
    assert (tmp_path / "one.html").read_text() == "page"
    monkeypatch.setattr(comparisonpage, "build_comparison_page", lambda _: "pages")
    code, out, _ = said(capsys, monkeypatch, folder, other, "--out", tmp_path / "both.html", "--json")
    assert code == 0
    assert json.loads(out)["changed"]["seed"] == ["3", "4"]
    assert (tmp_path / "both.html").read_text() == "pages"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nowhere"], "nowhere: no such run"),
        (["{run}", "--animate", "{run}/x.avi"], "an animation is one of .gif, .mp4"),
        (["{run}", "{run}", "--animate", "x.gif"], "--animate shows one run; got 2"),
    ],
)
def test_what_cannot_be_reported_ends_with_2_and_one_line(words, message, folder, capsys, monkeypatch):
    code, out, err = said(capsys, monkeypatch, *(word.format(run=folder) for word in words))
    assert code == 2
    assert out == ""
    assert message in err
    assert err.count("\n") == 1


def test_a_length_without_an_animation_is_refused(folder):
    from smolbot.ui.cli.report import report

    for options in ({"seconds": 3.0}, {"fps": 5}):
        with pytest.raises(InputError, match="--animate"):
            report([folder], **options)
