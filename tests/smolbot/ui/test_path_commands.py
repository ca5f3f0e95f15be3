"""Paths from the command line: what preview says of them, what init copies, which faults are told where."""

from __future__ import annotations

import json
import re
import sys
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from smolbot.config.mission import load_steering_mission
from smolbot.errors import ConfigError
from smolbot.ui.cli import app as command_line

LINE = (Path(str(resources.files("smolbot"))) / "missions/line.toml").read_text()
PLAIN = "points_mm = [[-4.0, 0.0], [4.0, 0.0]]"
BOX = '<svg xmlns="http://www.w3.org/2000/svg" width="20mm" height="20mm" viewBox="0 0 20 20">{}</svg>'
HOOK = '<path id="hook" d="M 2 2 L 12 2 L 12 10"/>'


@pytest.fixture
def smolbot(monkeypatch, capsys, tmp_path):
    """``code, out, err = smolbot("run", "line")``, in an empty directory."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["smolbot", *arguments])
        with pytest.raises(SystemExit) as ended:
            command_line.main()
        out, err = capsys.readouterr()
        assert "Traceback" not in out + err
        return int(ended.value.code or 0), out, err

    return call


@pytest.fixture
def lay(tmp_path):
    """``lay(path section)`` writes a mission, and a drawing beside it."""

    def write(section: str, svg: str = HOOK) -> str:
        (tmp_path / "hook.svg").write_text(BOX.format(svg))
        path = tmp_path / "mine.toml"
        path.write_text(LINE.replace(PLAIN, section))
        return str(path)

    return write


def test_preview_tells_length_corners_and_the_tightest_bend(smolbot, lay):
    section = 'file = "hook.svg"\nwidth_mm = 12.0\ncorner_radius_mm = 1.5\nspeed_mm_s = 0.3'
    lay(section)
    code, out, _ = smolbot("preview", "mine.toml", "--json")
    seen = json.loads(out)
    length = 12.0 + 9.6 - 3.0 + 0.75 * np.pi
    assert code == 0
    assert seen["path_length_mm"] == pytest.approx(length, rel=1e-3)
    assert seen["path_corners"] == 0
    assert seen["path_tightest_bend_mm"] == pytest.approx(1.5, rel=1e-3)
    assert seen["path_time_wanted_s"] == pytest.approx(length / 0.3, rel=1e-3)
    assert seen["path_time_s"] == pytest.approx(length / 0.3, rel=0.1)


def test_preview_says_what_was_done_to_a_letter_and_what_no_law_can_do(smolbot, lay):
    lay('glyph = "i"\nwidth_mm = 2.0\nheight_mm = 8.0\nspeed_mm_s = 50.0')
    _, out, _ = smolbot("preview", "mine.toml")
    flat = re.sub(r"\s+", " ", out)
    assert "'i' has parts that do not touch" in flat
    assert "more than the law can do" in flat
    assert re.search(r"path \d+\.\d mm, 4 corners, no bends", flat)


def test_list_tells_of_glyphs(smolbot):
    code, out, _ = smolbot("list", "--json")
    assert code == 0
    assert "A to Z" in json.loads(out)["glyphs"]


@pytest.mark.parametrize("spelling", ['file = "drawings/hook.svg"', "file='drawings/hook.svg'"])
def test_init_copies_a_missions_drawing_with_it(smolbot, lay, tmp_path, spelling):
    lay(spelling)
    (tmp_path / "drawings").mkdir()
    (tmp_path / "hook.svg").rename(tmp_path / "drawings/hook.svg")
    assert smolbot("init", "copy", "--mission", "mine.toml")[0] == 0
    assert sorted(p.name for p in (tmp_path / "copy").iterdir()) == [
        "gradient.toml",
        "hook.svg",
        "mine.toml",
        "tank.toml",
    ]
    (tmp_path / "drawings/hook.svg").unlink()
    ours, theirs = load_steering_mission(str(tmp_path / "copy/mine.toml")), BOX
    assert ours.path.length * 1e3 == pytest.approx(18.0, rel=1e-4), theirs
    assert smolbot("init", "again", "--mission", "copy/mine.toml")[0] == 0  # a copy can be copied
    code, _, err = smolbot("init", "third", "--mission", "mine.toml")
    assert code == 2
    assert "drawings/hook.svg: no such file" in err
    assert not (tmp_path / "third").exists()


@pytest.mark.parametrize(
    ("section", "key", "words"),
    [
        ('file = "nowhere.svg"', "path.file", ["nowhere.svg: cannot be read"]),
        ('file = "hook.svg"\nelement = "hok"', "path.file", ["no element has the id 'hok'", "hook"]),
        ('file = "hook.svg"\nelement = ""', "path.file", ["no element has the id ''"]),
        ('file = "hook.svg"\nwidth_mm = 0.0', "path.width_mm", ["greater than 0", "0.0"]),
        ('glyph = "S"\nwidth_mm = 0.0\nheight_mm = 3.0', "path.width_mm", ["greater than 0"]),
        ('glyph = "SMOL"\nwidth_mm = 9.0\nheight_mm = 3.0', "path.glyph", ["one character, got 4", "word"]),
        (f"{PLAIN}\ncorner_radius_mm = -0.5", "path.corner_radius_mm", ["greater than or equal to 0", "-0.5"]),
        (f"{PLAIN}\nspeed_mm_s = 0.0", "path.speed_mm_s", ["greater than 0"]),
        (f"{PLAIN}\nspeed_mm_s = -1.0", "path.speed_mm_s", ["greater than 0"]),
        (f"{PLAIN}\nlateral_mm_s2 = 1.0", "path", ["give speed_mm_s too"]),
        (f"{PLAIN}\nspeed_mm_s = 1.0\nacceleration_mm_s2 = 1.0", "path", ["give lateral_mm_s2 too"]),
        (f'{PLAIN}\nelement = "hook"', "path", ["element names a shape of an SVG"]),
        (f"{PLAIN}\nwidth_mm = 9.0", "path", ["belong to a glyph or an SVG"]),
        (f"{PLAIN}\nspeed = 1.0", "path.speed", ["Did you mean speed_mm_s?"]),
        ('file = "hook.svg"\nwidth_mm = 43.0', "path", ["lies outside the tank"]),
        ('glyph = "E"\nwidth_mm = 41.0\nheight_mm = 20.0\ncorner_radius_mm = 1.0', "path", ["lies outside the tank"]),
        ('glyph = "V"\nwidth_mm = 20.0\nheight_mm = 60.0', "path", ["lies outside the field table"]),
    ],
)
def test_a_path_that_cannot_be_flown_is_told_with_its_key(lay, section, key, words):
    with pytest.raises(ConfigError) as error:
        load_steering_mission(lay(section))
    lines = [line for line in str(error.value).splitlines() if ": start: " not in line]
    fitting = [line for line in lines if re.search(rf"mine\.toml:\d+: {re.escape(key)}: ", line)]
    assert fitting, lines
    for word in words:
        assert word in "\n".join(fitting)


def test_broken_drawings_name_mission_drawing_and_element(lay):
    with pytest.raises(ConfigError, match=r"mine\.toml:\d+: path\.file: .*hook\.svg: element 'a': the line ends at"):
        load_steering_mission(lay('file = "hook.svg"', '<path id="a" d="M 0 0 h 3 m 1 0 h 3"/>'))
    with pytest.raises(ConfigError, match=r"mine\.toml:\d+: path\.file: .*hook\.svg:1: not valid XML"):
        load_steering_mission(lay('file = "hook.svg"', "<path"))


def test_paths_stay_in_space_at_the_liquids_surface(lay):
    mission = load_steering_mission(lay('file = "hook.svg"\ncenter_mm = [1.0, -2.0]'))
    assert mission.path.points.shape[1] == 3
    assert mission.path.points[:, 2] == pytest.approx(mission.rig.surface_z)
    assert mission.path.points[:, :2] * 1e3 == pytest.approx(np.array([[-4, 2], [6, 2], [6, -6.0]]), abs=1e-4)
