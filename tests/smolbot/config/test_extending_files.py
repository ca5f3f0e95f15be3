"""Files that extend others, and settings: one text that stands alone, each reason beside the value that it is of."""

from __future__ import annotations

import copy
import json
import re
import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from smolbot.config.document import Document
from smolbot.config.library import holds_rig, list_shipped, open_file
from smolbot.config.load import load_mission
from smolbot.config.rig import load_rig
from smolbot.config.robot import load_robot
from smolbot.config.toml_layers import lay_over, read_layer, set_values, write_layer
from smolbot.errors import ConfigError
from smolbot.runs.recording.run_files import RunFiles

EVERY = [(kind, name) for kind in ("missions", "rigs", "robots") for name in list_shipped(kind)]


def comments(text: str) -> int:
    return sum("#" in line for line in text.splitlines())


@pytest.fixture
def write(tmp_path):
    """``write("a.toml", text)`` writes a file and returns its path as text."""

    def to(name: str, text: str) -> str:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        return str(path)

    return to


@pytest.mark.parametrize(("kind", "name"), EVERY)
def test_a_text_that_is_taken_apart_and_put_together_says_the_same_with_every_comment(kind, name):
    text = list_shipped(kind)[name].read_text(encoding="utf-8")
    again = write_layer(read_layer(text))
    assert tomllib.loads(again) == tomllib.loads(text)
    assert sorted(filter(None, again.splitlines())) == sorted(filter(None, text.splitlines()))


@pytest.mark.parametrize(("kind", "name"), EVERY)
def test_the_resolved_text_of_a_file_says_what_the_file_and_its_parents_say(kind, name):
    document = open_file(name, kind)
    assert tomllib.loads(document.text) == document.data
    assert Document(document.path, document.text).data == document.data
    assert "extends" not in document.data


def test_one_setting_changes_one_line_and_keeps_every_comment():
    plain, changed = load_rig("tank").document.text, load_rig("tank", {"limits.max_current_a": "6.0"}).document.text
    assert comments(plain) == 69
    assert comments(changed) == 69
    differ = [(old, new) for old, new in zip(plain.splitlines(), changed.splitlines(), strict=True) if old != new]
    (old, new) = differ[0]
    assert len(differ) == 1
    assert old.replace("8.0", "6.0") == new


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("limits.max_current_a", "6.5"),
        ("noise.harmonics.3", "0.5"),
        ("noise.harmonics", "{ 7 = 0.1 }"),
        ("limits.unipolar", "false"),
        ("safety.broken_sensors", "[3, 4]"),
        ("tank.mismatch.scale", "0.0"),
        ("coils", "[]"),
        ("description", "said otherwise"),
        ("tank.hand.rest_s", "1.0"),
        ("tank", '{ a = 1, b = { c = "x" } }'),
    ],
)
def test_the_text_with_settings_says_what_the_settings_say(name, value):
    changed = open_file("tank", "rigs").override({name: value})
    assert tomllib.loads(changed.text) == changed.data
    assert changed.data != open_file("tank", "rigs").data


KEYS = st.sampled_from(["a", "b", "c d", "e"])
VALUES = st.one_of(
    st.integers(-9, 9),
    st.booleans(),
    st.floats(allow_nan=False),
    st.text("xy#\"'\\ ", max_size=4),
    st.lists(st.integers(), max_size=2),
)
TABLES = st.recursive(
    st.dictionaries(KEYS, VALUES, max_size=3),
    lambda inner: st.dictionaries(KEYS, VALUES | inner, max_size=3),
    max_leaves=8,
)


def told(table: dict, at: str = "", depth: int = 0) -> str:
    """TOML of a table, each of its tables with a header of its own."""
    lines = [f"{json.dumps(k)} = {spelled(v)}  # {k} at {at}" for k, v in table.items() if not isinstance(v, dict)]
    inner = [(f"{at}.{json.dumps(k)}".lstrip("."), v) for k, v in table.items() if isinstance(v, dict)]
    return "\n".join([*lines, *(f"\n# of {name}\n[{name}]\n{told(v, name)}" for name, v in inner)])


def spelled(value) -> str:
    if isinstance(value, float) and value in (float("inf"), float("-inf")):
        return str(value)
    return json.dumps(value)


def merged(base: dict, upper: dict) -> dict:
    found = copy.deepcopy(base)
    for key, value in upper.items():
        both = isinstance(value, dict) and isinstance(found.get(key), dict)
        found[key] = merged(found[key], value) if both else value
    return found


@given(base=TABLES, upper=TABLES)
def test_tables_are_merged_key_by_key_and_values_replaced_whole(base, upper):
    text = lay_over(told(base), told(upper), ())
    assert tomllib.loads(text) == merged(base, upper)


@given(base=TABLES, value=VALUES, key=st.lists(KEYS, min_size=1, max_size=3).map(tuple))
def test_a_value_that_is_set_is_there_and_nothing_else_has_changed(base, value, key):
    expected = copy.deepcopy(base)
    table = expected
    for part in key[:-1]:
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            return
    table[key[-1]] = value
    assert tomllib.loads(set_values(told(base), {key: value})) == expected


def test_a_reason_goes_where_its_value_goes():
    base = "# The bench.\nname = 'a'\n\n# Of coils.\n[limits]\nlow = 1.0  # the amplifier\nhigh = 8.0  # the supply\n"
    upper = "# Mine.\nextends = 'a'\n\n[limits]\nhigh = 6.0  # my coils\nnew = 1  # only mine\n"
    text = lay_over(base, upper, [("extends",)])
    assert "low = 1.0  # the amplifier" in text
    assert "high = 6.0  # my coils" in text
    assert "new = 1  # only mine" in text
    assert "the supply" not in text
    assert text.index("# Mine.") < text.index("# The bench.")
    assert "# Of coils.\n[limits]" in text
    assert "high = 6.0\n" in lay_over(base, "[limits]\nhigh = 6.0\n", ())  # the old reason is none of the new value


def test_a_rig_says_only_what_differs_and_has_all_else_of_its_parent(write):
    path = write("mine.toml", 'extends = "tank"\nname = "mine"\n[limits]\nmax_current_a = 5.0  # our supply\n')
    rig, tank = load_rig(path), load_rig("tank")
    assert rig.limits.max_current == 5.0
    assert rig.name == "mine"
    assert rig.limits.max_excitation == tank.limits.max_excitation
    assert rig.coil_names == tank.coil_names
    assert (rig.sensors.positions == tank.sensors.positions).all()


def test_arrays_of_tables_are_replaced_whole(write):
    coil = tomllib.loads(open_file("tank", "rigs").text)["coils"][0]
    lines = "\n".join(f"{key} = {json.dumps(value)}" for key, value in coil.items())
    path = write("mine.toml", f'extends = "tank"\nname = "mine"\n[[coils]]\n{lines}\n')
    assert load_rig(path).coil_names == ("+x",)


def test_missions_and_robots_extend_likewise(write):
    robot = write("thick.toml", 'extends = "gradient"\nname = "thick"\n[device]\nl0_mm = 1.6\n')
    assert load_robot(robot).device.l0 == pytest.approx(1.6e-3)
    path = write("mine.toml", 'extends = "line"\nname = "mine"\nrobot = "thick.toml"\n[stop]\nmax_duration_s = 5.0\n')
    mission = load_mission(path)
    assert (mission.name, mission.robot.name, mission.law) == ("mine", "thick", load_mission("line").law)
    assert mission.base.stop.max_duration_s == 5.0


def test_a_file_that_a_parent_names_is_looked_for_beside_the_parent(write):
    write("lab/path.csv", "0,0\n5,0\n")
    line = re.sub(r"(?s)\[path\].*?\n\n", '[path]\nfile = "path.csv"\n\n', open_file("line", "missions").text, count=1)
    write("lab/base.toml", line)
    child = write("elsewhere/mine.toml", 'extends = "../lab/base.toml"\nname = "mine"\n')
    assert load_mission(child).path.length == pytest.approx(5e-3)
    files = RunFiles.of(load_mission(child)).contents
    assert files["path.csv"] == b"0,0\n5,0\n"


def test_a_fault_of_an_inherited_key_names_file_and_line_of_the_parent(write):
    text = open_file("tank", "rigs").text.replace("max_current_a = 8.0", 'max_current_a = "eight"')
    line = next(i for i, each in enumerate(text.splitlines(), 1) if '"eight"' in each)
    write("lab.toml", text)
    path = write("mine.toml", 'extends = "lab.toml"\nname = "mine"\n[limits]\nmax_current = 3.0\n')
    with pytest.raises(ConfigError) as error:
        load_rig(path)
    own, inherited = str(error.value).splitlines()
    assert own.startswith(f"{path}:4: limits.max_current: unknown key")
    assert f"lab.toml:{line}: limits.max_current_a: " in inherited


def test_a_section_that_a_child_replaces_is_the_childs_fault(write):
    path = write("mine.toml", 'extends = "tank"\nname = "mine"\ncoils = [{ name = "+x" }]\n')
    with pytest.raises(ConfigError) as error:
        load_rig(path)
    assert all(line.startswith(f"{path}:3: coils.0.") for line in str(error.value).splitlines())


@pytest.mark.parametrize("others", [{}, {"b.toml": "a.toml"}, {"b.toml": "c.toml", "c.toml": "a.toml"}])
def test_files_that_extend_one_another_in_a_circle_are_named(write, others):
    for name, parent in others.items():
        write(name, f'extends = "{parent}"\n')
    path = write("a.toml", f'\nextends = "{next(iter(others), "a.toml")}"\n')
    with pytest.raises(ConfigError, match="goes round in a circle") as error:
        load_rig(path)
    assert re.match(r".*\w\.toml:[12]: extends: ", str(error.value))
    for name in ("a.toml", *others):
        assert name in str(error.value)


@pytest.mark.parametrize(
    ("parent", "words"), [('"tonk"', "Did you mean tank?"), ('"../no.toml"', "../no.toml"), ("3", "got 3")]
)
def test_an_unknown_parent_names_both_files(write, parent, words):
    path = write("mine.toml", f'name = "mine"\nextends = {parent}\n')
    with pytest.raises(ConfigError) as error:
        load_rig(path)
    assert str(error.value).startswith(f"{path}:2: extends: ")
    assert words in str(error.value)


def test_whether_a_file_is_a_rigs_is_told_by_what_it_extends(write):
    assert holds_rig(list_shipped("rigs")["twin"])
    assert not holds_rig(list_shipped("missions")["s_path_blocked"])
    assert not holds_rig(write.__closure__[0].cell_contents / "nothing.toml")


def test_a_run_folder_holds_files_that_stand_alone_with_their_comments():
    mission = load_mission("s_path_blocked", None, {"rig.limits.max_listen_ms": "2500.0"})
    contents = RunFiles.of(mission).contents
    for name in ("mission.toml", "rig.toml", "robot.toml"):
        data = tomllib.loads(contents[name].decode())
        assert "extends" not in data
    rig = contents["rig.toml"].decode()
    assert tomllib.loads(rig) == mission.rig.document.data
    assert "max_listen_ms = 2500.0            # buffer of the converter" in rig
    assert "where the two bowls of the S meet" in rig
    assert comments(rig) >= comments(open_file("gel", "rigs").text)


PATHS = {"path.file": "own.csv", "path.points_mm": "[[0, 0], [5, 0]]", "path.glyph": "I"}


@pytest.mark.parametrize("name", PATHS)
def test_a_path_that_is_set_takes_the_place_of_the_files(write, name):
    write("own.csv", "0,0\n5,0\n")
    path = write("mine.toml", open_file("line", "missions").text)
    more = {"path.width_mm": "2.0", "path.height_mm": "5.0"} if name == "path.glyph" else {}
    mission = load_mission(path, None, {name: PATHS[name], **more})
    assert mission.path.length == pytest.approx(5e-3)
    assert tomllib.loads(mission.document.text) == mission.document.data
    assert len({"glyph", "points_mm", "file"} & set(mission.document.data["path"])) == 1


def test_two_kinds_of_path_that_are_set_are_one_too_many():
    with pytest.raises(ConfigError, match="give one of glyph, points_mm or file; got points_mm, file"):
        load_mission("r_path", None, {"path.file": "own.csv", "path.points_mm": "[[0, 0], [5, 0]]"})


def test_a_glyph_that_is_set_keeps_the_size_of_the_files_own():
    assert load_mission("r_path", None, {"path.glyph": "S"}).document.data["path"]["height_mm"] == 24.0


def test_a_file_that_extends_a_mission_may_follow_another_kind_of_path(write):
    write("own.csv", "0,0\n5,0\n")
    path = write("mine.toml", 'extends = "r_path"\nname = "mine"\n[path]\nfile = "own.csv"\n')
    mission = load_mission(path)
    assert mission.path.length == pytest.approx(5e-3)
    assert mission.document.data["path"] == {"center_mm": [0.0, 0.0], "file": "own.csv"}


@pytest.mark.parametrize("key", ["extends", "rig.extends"])
def test_a_setting_of_extends_is_refused_not_ignored(key):
    with pytest.raises(ConfigError, match=r"--set \S*extends=tank: a file extends what it says itself"):
        load_mission("line", settings={key: "tank"})
