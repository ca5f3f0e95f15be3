"""Files of users: every fault is told at once, with file, line and key, what was asked and what is possible."""

from __future__ import annotations

import re
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from lookup_tables import FieldTable
from smolbot.config.document import Document
from smolbot.config.library import find_file, list_shipped
from smolbot.config.load import load_mission
from smolbot.config.rig import load_rig
from smolbot.config.robot import load_robot
from smolbot.errors import ConfigError, MissingFileError, SmolbotError

SHIPPED = Path(str(resources.files("smolbot")))
LINE = (SHIPPED / "missions/line.toml").read_text()
TANK = (SHIPPED / "rigs/tank.toml").read_text()
ROBOT = (SHIPPED / "robots/gradient.toml").read_text()


def changed(text: str, old: str, new: str) -> str:
    assert text.count(old) >= 1, old
    return text.replace(old, new, 1)


def line_of(text: str, part: str) -> int:
    return next(i for i, line in enumerate(text.splitlines(), 1) if part in line)


@pytest.fixture
def lay(tmp_path):
    """``lay(mission, rig=..., robot=...)`` writes files beside each other and returns the mission's path."""

    def write(mission: str, rig: str | None = None, robot: str | None = None) -> str:
        if rig is not None:
            (tmp_path / "my_rig.toml").write_text(rig)
            mission = changed(mission, 'rig = "tank"', 'rig = "my_rig.toml"')
        if robot is not None:
            (tmp_path / "my_robot.toml").write_text(robot)
            mission = changed(mission, 'robot = "gradient"', 'robot = "my_robot.toml"')
        path = tmp_path / "mine.toml"
        path.write_text(mission)
        return str(path)

    return write


def faults_of(action) -> list[str]:
    with pytest.raises(ConfigError) as error:
        action()
    assert isinstance(error.value, SmolbotError)
    assert isinstance(error.value, ValueError)
    return str(error.value).splitlines()


def only_fault(action) -> str:
    faults = faults_of(action)
    assert len(faults) == 1, faults
    return faults[0]


@pytest.mark.parametrize(
    ("old", "new", "key", "words"),
    [
        (
            "tolerance_mm = 0.8",
            "tolerence_mm = 0.8",
            "controller.tolerence_mm",
            ["unknown key", "Did you mean tolerance_mm?"],
        ),
        ("tolerance_mm = 0.8", "tolerance_m = 0.0008", "controller.tolerance_m", ["Did you mean tolerance_mm?"]),
        ("tolerance_mm = 0.8", "tolerance_um = 800", "controller.tolerance_um", ["Did you mean tolerance_mm?"]),
        ("tolerance_mm = 0.8", "tolerance = 0.8", "controller.tolerance", ["Did you mean tolerance_mm?"]),
        ("ring_down_ms = 20.0", "ring_down_s = 0.02", "cycle.ring_down_s", ["Did you mean ring_down_ms?"]),
        ("tolerance_mm = 0.8", "tolerance_mm = -1", "controller.tolerance_mm", ["greater than 0", "-1"]),
        ("tolerance_mm = 0.8", 'tolerance_mm = "0.8"', "controller.tolerance_mm", ["number", '"0.8"']),
        ("tolerance_mm = 0.8", "tolerance_mm = nan", "controller.tolerance_mm", ["number"]),
        ("tolerance_mm = 0.8", "tolerance_mm = inf", "controller.tolerance_mm", []),
        ("half_periods = 2", "half_periods = 2.5", "cycle.half_periods", ["2.5"]),
        ("half_periods = 2", "half_periods = 0", "cycle.half_periods", ["greater than or equal to 1"]),
        ("excite_cycles = 5", "excite_cycles = true", "cycle.excite_cycles", ["integer"]),
        ('law = "current_ratio"', 'law = "current_ration"', "controller.law", ["current_ration", "current_ratio"]),
        ("[verdict]", "[verdikt]", "verdikt", ["unknown key", "Did you mean verdict?"]),
        ("estimator = ", 'estimator = "paler" # ', "localization.estimator", ["paper"]),
        ("[4.0, 0.0]]", '["four", 0.0]]', "path.points_mm.1.0", ["number", "four"]),
        ("[4.0, 0.0]]", "[4.0]]", "path.points_mm.1", ["entry 2 is missing", "[4.0]"]),
        ("[4.0, 0.0]]", "[4.0, 1.0, 2.0]]", "path.points_mm.1", ["3"]),
        ('law = "current_ratio"\n', "", "controller.law", ["missing", "law"]),
    ],
)
def test_one_bad_line_is_one_fault_with_its_place(lay, old, new, key, words):
    text = changed(LINE, old, new)
    fault = only_fault(lambda: load_mission(lay(text)))
    first = new.splitlines()[0] if new else "[controller]"
    assert re.match(rf".*mine\.toml:{line_of(text, first)}: ", fault), fault
    assert f": {key}: " in fault
    for word in words:
        assert word in fault


def test_an_unknown_key_is_told_all_known_ones(lay):
    fault = only_fault(lambda: load_mission(lay(changed(LINE, "tolerance_mm", "xyz"))))
    assert "known keys: law, tolerance_mm, gains." in fault


def test_four_faults_are_four_lines_in_the_order_of_the_file(lay):
    text = changed(LINE, "points_mm = ", "pionts_mm = ")
    text = changed(text, "tolerance_mm = 0.8", "tolerence_mm = 0.8")
    text = changed(text, "ring_down_ms = 20.0", "ring_down_ms = -3")
    text = changed(text, "lost_shots = 20", 'lost_shots = "many"')
    faults = [f for f in faults_of(lambda: load_mission(lay(text))) if "give one of" not in f]
    lines = [int(re.search(r"mine\.toml:(\d+):", f)[1]) for f in faults]
    assert lines == [line_of(text, part) for part in ("pionts_mm", "tolerence_mm", "ring_down_ms", "lost_shots")]


def test_faults_of_mission_rig_and_robot_come_at_once_each_with_its_own_file(lay):
    path = lay(
        changed(LINE, "tolerance_mm", "tolerence_mm"),
        changed(TANK, "max_current_a = 8.0", "max_current_a = -8.0"),
        changed(ROBOT, "l0_mm = 1.5", "l0 = 1.5"),
    )
    faults = faults_of(lambda: load_mission(path))
    files = {re.search(r"(\w+)\.toml:\d+: ", f)[1] for f in faults}
    assert files == {"mine", "my_rig", "my_robot"}
    assert any("limits.max_current_a" in f for f in faults)
    assert any("Did you mean l0_mm?" in f for f in faults)


@pytest.mark.parametrize(
    ("gain", "words"),
    [
        ("i_min_aa = 3.0", ["unknown gain of current_ratio", "Did you mean i_min_a?", "t_max_ms"]),
        ("i_min_a = 99.0", ["0.5 to 20", "99"]),
        ("t_min_ms = -1.0", ["5 to 100", "-1"]),
        ('i_min_a = "strong"', ["number"]),
    ],
)
def test_a_gain_that_the_law_does_not_have_or_bear_is_a_fault_of_its_line(lay, gain, words):
    text = changed(LINE, "[cycle]", f"[controller.gains]\n{gain}\n\n[cycle]")
    fault = only_fault(lambda: load_mission(lay(text)))
    assert f"mine.toml:{line_of(text, gain)}: controller.gains.{gain.split()[0]}: " in fault
    for word in words:
        assert word in fault


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("points_mm = [[0, 0], [1, 0]]\nglyph = 'R'", ["give one of glyph, points_mm or file", "glyph, points_mm"]),
        ("", ["give one of glyph, points_mm or file; got none"]),
        ("glyph = 'ß'\nwidth_mm = 4\nheight_mm = 4", ["no glyph is named 'ß'", "A to Z, a to z, 0 to 9"]),
        ("glyph = 'R'", ["width_mm and height_mm"]),
        ("points_mm = [[0, 0]]", ["at least two points"]),
        ("points_mm = [[0, 0], [0, 0]]", ["coincide"]),
        ("file = 'nowhere.csv'", ["nowhere.csv"]),
    ],
)
def test_a_path_is_one_of_letter_points_or_file(lay, text, words):
    mission = changed(LINE, "points_mm = [[-4.0, 0.0], [4.0, 0.0]]", text)
    fault = only_fault(lambda: load_mission(lay(mission)))
    place = re.search(r"mine\.toml:(\d+): path(\.\w+)?: ", fault)
    assert place, fault
    assert int(place[1]) == line_of(mission, "[path]") + (place[2] is not None)
    for word in words:
        assert word in fault


def test_a_path_may_be_a_csv_file_beside_the_mission(lay, tmp_path):
    (tmp_path / "p.csv").write_text("x,y\n-3,0\n3,1\n")
    mission = changed(LINE, "points_mm = [[-4.0, 0.0], [4.0, 0.0]]", 'file = "p.csv"\ncenter_mm = [1, 0]')
    loaded = load_mission(lay(mission))
    assert loaded.path.points[:, :2] * 1e3 == pytest.approx(np.array([[-2, 0], [4, 1.0]]))
    assert loaded.path.points[:, 2] == pytest.approx(loaded.rig.surface_z)
    (tmp_path / "p.csv").write_text("x,y\n-3,0\n3,one\n")
    fault = only_fault(lambda: load_mission(lay(mission)))
    assert f"{tmp_path / 'p.csv'}:3: each row must be two numbers" in fault


@pytest.mark.parametrize(
    ("old", "new", "known"),
    [('rig = "tank"', 'rig = "tnak"', "tank"), ('robot = "gradient"', 'robot = "gradiant"', "gradient")],
)
def test_a_rig_or_robot_that_does_not_exist_is_a_fault_of_the_line_that_names_it(lay, old, new, known):
    text = changed(LINE, old, new)
    fault = only_fault(lambda: load_mission(lay(text)))
    assert f"mine.toml:{line_of(text, new)}: {new.split()[0]}: " in fault
    assert f"Did you mean {known}?" in fault


def test_a_rig_file_that_does_not_exist_is_a_fault_too(lay):
    text = changed(LINE, 'rig = "tank"', 'rig = "./nowhere/rig.toml"')
    fault = only_fault(lambda: load_mission(lay(text)))
    assert f":{line_of(text, 'nowhere')}: rig: " in fault
    assert "no such file" in fault


def test_a_mission_that_does_not_exist_is_told_which_do(tmp_path):
    for name in ("r_smal", str(tmp_path / "r_small.toml")):
        with pytest.raises(MissingFileError) as error:
            load_mission(name)
        assert isinstance(error.value, FileNotFoundError)
        assert "line, r_path, r_small" in str(error.value)
        assert "\n" not in str(error.value)
    with pytest.raises(MissingFileError, match="Did you mean r_small"):
        load_mission("r_smal")


@pytest.mark.parametrize("text", ["name = \n", "[path\n", 'name = "a"\nname = "b"\n', "a = 1\nb = 2,\n"])
def test_what_is_not_toml_is_told_by_line(lay, text):
    fault = only_fault(lambda: load_mission(lay(text)))
    assert re.search(r"mine\.toml:\d+: not valid TOML", fault)


def test_a_file_that_is_no_text_is_one_fault(tmp_path):
    path = tmp_path / "bytes.toml"
    path.write_bytes(b"\xff\xfe\x00name")
    assert "cannot be read as text" in only_fault(lambda: load_mission(str(path)))
    with pytest.raises(SmolbotError):
        load_mission(str(tmp_path) + "/")


@pytest.mark.parametrize(
    ("old", "new", "key", "words"),
    [
        ('world = "tank"', 'world = "moon"', "world", ["no world is named 'moon'", "tank"]),
        ("range_ut = 10.0", "range_mt = 0.01", "sensors.range_mt", ["Did you mean range_ut?"]),
        ('"x", "x", "y", "y"]', '"x", "x", "y"]', "sensors", ["10 positions_mm but 9 axes"]),
        ("inner_radius_mm = 15.0", "inner_radius_mm = 45.0", "coils.0", ["must exceed inner_radius_mm"]),
        ("axis = [0, -1, 0]", "axis = [0, 0, 0]", "coils.3.axis", ["must have a direction"]),
        ("axis = [1, 0, 0]\nlength_mm = 60", "axis = [0, 0, 0]\nlength_mm = 60", "excitation.0.axis", ["direction"]),
        ("surface_z_mm = 60.0", "surface_z_mm = 40.0", "container", ["must lie above floor_z_mm"]),
        ("x_mm = [-24, 24]", "x_mm = [24, -24]", "table", ["from low to high"]),
        ("x_mm = [-24, 24]\n", "", "table", ["all of x_mm, y_mm and z_mm"]),
        ("harmonics = { 2 =", "harmonics = { 1 =", "noise.harmonics", ["from 2 up"]),
        ("max_listen_ms = 3000.0", "max_listen_s = 3.0", "limits.max_listen_s", ["Did you mean max_listen_ms?"]),
        ("physics_step_ms = 1.0", "physics_step_ms = 0", "tank.physics_step_ms", ["greater than 0"]),
        ("scale = 1.0", "scael = 1.0", "tank.mismatch.scael", ["Did you mean scale?"]),
        (
            'name = "y"\ncenter_mm = [0, 0, 14]',
            'name = "z"\ncenter_mm = [0, 0, 14]',
            "excitation.1.name",
            ["'x' or 'y'"],
        ),
    ],
)
def test_one_bad_line_of_a_rig_is_one_fault_with_its_place(tmp_path, old, new, key, words):
    path = tmp_path / "rig.toml"
    text = changed(TANK, old, new)
    path.write_text(text)
    faults = [f for f in faults_of(lambda: load_rig(str(path))) if "this key is missing" not in f]
    assert len(faults) == 1
    assert f": {key}: " in faults[0]
    said = int(re.search(r"rig\.toml:(\d+):", faults[0])[1])
    changed_at = line_of(text, new.splitlines()[0]) if new else line_of(text, "[table]")
    assert line_of(text, "[sensors]") <= said <= changed_at or said == changed_at
    for word in words:
        assert word in faults[0]


def test_a_robot_is_checked_likewise(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(changed(changed(ROBOT, "theta_max_deg = 17.8", "theta_max_deg = 78"), "[body]", "[bdoy]"))
    faults = faults_of(lambda: load_robot(str(path)))
    assert any("device.theta_max_deg: " in f and "60" in f for f in faults)
    assert any("Did you mean body?" in f for f in faults)


@pytest.mark.parametrize("direction", ["[0, 0, 0]", "[0, 1, 0]"])
def test_a_moment_out_of_the_plane_of_swing_is_a_fault_of_its_line(lay, direction):
    robot = changed(ROBOT, "moment_in_body = [0, 0, 1]", f"moment_in_body = {direction}")
    fault = only_fault(lambda: load_mission(lay(LINE, robot=robot)))
    assert f"my_robot.toml:{line_of(robot, 'moment_in_body')}: device.moment_in_body" in fault


@pytest.fixture(scope="module")
def export(tmp_path_factory) -> str:
    """A good COMSOL export of the shipped coils, coarse."""
    rig = load_rig("tank", {"table.mesh_mm": "2.0", "table.x_mm": "[-8, 8]", "table.y_mm": "[-8, 8]"})
    path = tmp_path_factory.mktemp("table") / "coils.txt"
    rig.table().write(path)
    return path.read_text()


def rig_with_table(name: str = "coils.txt") -> str:
    start, end = TANK.index("[table]"), TANK.index("[container]")
    return f'{TANK[:start]}[table]\nfile = "{name}"\n\n{TANK[end:]}'


def test_a_rig_may_read_its_table_from_an_export(lay, tmp_path, export):
    (tmp_path / "coils.txt").write_text(export)
    mission = load_mission(lay(LINE, rig_with_table()))
    place = np.array([[0.002, 0.001, 0.06]])
    assert mission.rig.table().field(place) == pytest.approx(load_rig("tank").table().field(place), rel=1e-3, abs=1e-9)


def spoil(export: str, how: str) -> tuple[str, int | None]:
    """The export with one thing wrong, and the line where it is."""
    lines = export.splitlines()
    at = next(i for i, line in enumerate(lines) if not line.startswith("%")) + 40
    cells = lines[at].split()
    if how == "hole":
        del lines[at]
        return "\n".join(lines) + "\n", None
    if how == "nan":
        cells[-1] = "NaN"
    elif how == "word":
        cells[-1] = "abc"
    elif how == "short row":
        cells.pop()
    elif how == "unequal mesh":
        x = cells[0]
        lines = [" ".join([str(float(x) + 0.7), *c[1:]]) if (c := line.split())[0] == x else line for line in lines]
        return "\n".join(lines) + "\n", None
    lines[at] = " ".join(cells)
    return "\n".join(lines) + "\n", at + 1


@pytest.mark.parametrize("how", ["hole", "nan", "word", "short row", "unequal mesh"])
def test_a_spoiled_table_is_one_fault_with_file_and_line_before_anything_moves(lay, tmp_path, export, how):
    text, line = spoil(export, how)
    (tmp_path / "coils.txt").write_text(text)
    faults = faults_of(lambda: load_mission(lay(LINE, rig_with_table())))
    assert len(faults) == (2 if how == "hole" else 1)  # a hole is a wrong count, and a node that is missing
    assert f"coils.txt:{line}: " in faults[0] if line else all("coils.txt" in f for f in faults)


def test_a_table_that_is_not_there_is_one_fault(lay):
    fault = only_fault(lambda: load_mission(lay(LINE, rig_with_table("nowhere.txt"))))
    assert "nowhere.txt: there is no such file" in fault


def test_a_coil_count_that_does_not_fit_the_table_is_a_fault_of_the_rig(lay, tmp_path, export):
    (tmp_path / "coils.txt").write_text(export)
    table = FieldTable.read(tmp_path / "coils.txt")
    three = FieldTable(table.x, table.y, table.z, table.samples[:3], table.names[:3])
    three.write(tmp_path / "coils.txt")
    rig = rig_with_table()
    fault = only_fault(lambda: load_mission(lay(LINE, rig)))
    assert f"my_rig.toml:{line_of(rig, 'coils.txt')}: table.file: " in fault
    assert "holds 3 coils; this rig file lists 4 (+x, -x, +y, -y)" in fault


def test_a_table_that_reaches_into_a_coil_is_a_fault_of_the_rig(lay):
    rig = changed(TANK, "x_mm = [-24, 24]", "x_mm = [-60, 60]")
    rig = changed(rig, "mesh_mm = 0.5 ", "mesh_mm = 3.0 ")
    fault = only_fault(lambda: load_mission(lay(LINE, rig)))
    assert "my_rig.toml" in fault


def test_settings_are_laid_over_mission_and_rig():
    settings = {"controller.tolerance_mm": "0.9", "rig.limits.max_current_a": "7.5", "controller.gains.i_min_a": "5"}
    mission = load_mission("line", settings=settings)
    assert mission.tolerance == pytest.approx(0.9e-3)
    assert mission.rig.limits.max_current == 7.5
    assert mission.gains == {"i_min_a": 5.0}


@pytest.mark.parametrize(
    ("setting", "value", "words"),
    [
        ("controller.tolerence_mm", "0.5", ["controller.tolerence_mm", "Did you mean tolerance_mm?"]),
        ("controler.tolerance_mm", "0.5", ["controler", "Did you mean controller?"]),
        ("controller.tolerance_mm", "small", ["controller.tolerance_mm", "small"]),
        ("rig.limits.max_curent_a", "5", ["limits.max_curent_a", "Did you mean max_current_a?"]),
        ("name.first", "x", ["name is not a section"]),
    ],
)
def test_a_setting_that_cannot_be_is_named_with_what_can(setting, value, words):
    fault = only_fault(lambda: load_mission("line", settings={setting: value}))
    for word in words:
        assert word in fault


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"sensors.positions_mm": "[[0, 0, 0]]", "sensors.axes": '["z"]'}, ["1 sensors", "0 same-axis", "needs 6"]),
        ({"sensors.sample_rate_hz": "100"}, ["100 Hz", "103.5 Hz needs 10350 Hz"]),
    ],
)
def test_sensors_that_cannot_find_a_pose_are_a_fault_of_the_rig(settings, words):
    fault = only_fault(lambda: load_mission("line", settings={f"rig.{k}": v for k, v in settings.items()}))
    assert ": rig: " in fault
    for word in words:
        assert word in fault


def test_every_shipped_file_loads_and_names_what_it_is():
    for kind, load in (("missions", load_mission), ("rigs", load_rig), ("robots", load_robot)):
        for name, path in list_shipped(kind).items():
            assert find_file(name, kind) == path
            assert load(name).name == name


def test_lines_of_keys_are_found_in_nested_arrays_and_tables(tmp_path):
    text = 'a = 1\n[b]\nc = [\n  [1, 2],\n  [3, 4],\n]\n[[d]]\ne = "[x]"\n[[d]]\ne = 2 # = 3\n[d.f]\n"g h" = 1\n'
    document = Document(tmp_path / "x.toml", text)
    expected = {("a",): 1, ("b",): 2, ("b", "c"): 3, ("b", "c", 1, 0): 5, ("d", 0, "e"): 8, ("d", 1, "e"): 10}
    expected |= {("d", 1, "f", "g h"): 12, ("b", "unknown"): 2, ("z",): 1}
    assert {key: document.line(key) for key in expected} == expected
