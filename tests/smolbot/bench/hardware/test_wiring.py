"""What cannot be wired is told when the rig file is read: all of it, each with its line."""

from __future__ import annotations

import copy
import re

import pytest

from smolbot.config.library import find_file, open_file
from smolbot.config.rig import load_rig
from smolbot.errors import ConfigError, RigError
from smolbot.flight.session import run


def edited(tmp_path, *changes, rig="bench"):
    text = find_file(rig, "rigs").read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"ai16"', '"ai8"', r"bench\.inputs\.channels: 'ai8' \(sensor 8\) is no differential input of a PCIe-6363"),
        ('"ai7"', '"ai6"', "input 'ai6' is named twice"),
        (', "ai17"]', "]", "9 inputs for 10 sensors"),
        ('product = "PCIe-6363"', 'product = "PCIe-6321"', "unknown product 'PCIe-6321'; known: PCIe-6363"),
        ('output = "ao3"', 'output = "ao4"', r"'ao4' is no output of a PCIe-6363; it has ao0 to ao3"),
        ('output = "ao1"', 'output = "ao0"', r"\+x and -x can be driven at once and so cannot share ao0"),
        ('relay = "port0/line2"', 'relay = "port0/line1"', "port0/line1 is taken by loads.1.relay"),
        ('relay = "port0/line2"', 'relay = "port1/line2"', "'port1/line2' is no clocked line"),
        ('enable = "port0/line6"', 'enable = "port0/line0"', "port0/line0 is taken"),
        ('coil = "+y"', 'coil = "+z"', r"this rig has no coil '\+z'; it has \+x, -x"),
        ("gain_a_per_v = 2.0 ", "gain_a_per_v = 0.5 ", r"\+x can get at most 5 A .*max_current_a is 8"),
        (
            'terminal = "differential"         # long cables in a room full of mains\nrange_v = 10.0',
            "range_v = 7.0",
            "must be one of 0.1, 0.2, 0.5, 1, 2, 5, 10; got 7",
        ),
        ("feed_ms = 15.0", "feed_ms = 90.0", "feed_ms must be at most 0.4 of timeout_ms"),
        ('all_open = "port1/line0"', 'all_open = "port9/line0"', "'port9/line0' is no line"),
        ("[bench.relays]", "[bench.relais]", "relais: unknown key"),
    ],
)
def test_impossible_wiring_is_refused_with_its_place(tmp_path, old, new, said):
    path = edited(tmp_path, (old, new))
    with pytest.raises(ConfigError, match=rf"mine\.toml:\d+: .*{said}"):
        load_rig(path)


def test_all_faults_are_told_at_once(tmp_path):
    path = edited(tmp_path, ('"ai16"', '"ai8"'), ('output = "ao3"', 'output = "ao9"'))
    with pytest.raises(ConfigError) as told:
        load_rig(path)
    assert len(str(told.value).splitlines()) == 2


def test_a_bench_needs_to_say_how_it_is_wired(tmp_path):
    text = find_file("tank", "rigs").read_text(encoding="utf-8").replace('world = "tank"', 'world = "bench"')
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=r"needs a section, \[bench\]"):
        load_rig(str(path))


def test_a_magnet_needs_a_stage(tmp_path):
    text = open_file("bench_gel", "rigs").text
    path = tmp_path / "mine.toml"
    path.write_text(re.sub(r"\[bench\.stage\].*?\n(\n|\Z)", "", text, flags=re.S), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"\[magnet\] needs \[bench\.stage\]"):
        load_rig(str(path))


ADDRESSES: tuple[tuple[str, ...], ...] = (("server",), ("truth",), ("stage", "port"), ("supply", "address"))
"""Keys of [bench] that say where a device is, not what it is: all in which a bench and its twin differ."""


@pytest.mark.parametrize("name", ["", "_gel"])
def test_bench_and_twin_differ_in_addresses_only(name):
    bench, twin = (copy.deepcopy(open_file(f"{kind}{name}", "rigs").data) for kind in ("bench", "twin"))
    for data in (bench, twin):
        data.pop("name")
        data.pop("description")
        for *path, last in ADDRESSES:
            section = data["bench"]
            for part in path:
                section = section.get(part, {})
            section.pop(last, None)
    assert bench == twin


def test_without_a_driver_one_error_says_how_to_use_the_twin(tmp_path):
    with pytest.raises(RigError, match="NI-DAQmx") as told:
        run("line", rig="bench", out=tmp_path / "run")
    assert "smolbot twin" in str(told.value)
    assert "nothing was energised" in str(told.value)


def test_every_device_that_fails_has_a_line(tmp_path):
    path = edited(tmp_path, ('port = ""', 'port = "/nowhere/tty"'), rig="bench_gel")
    with pytest.raises(RigError) as told:
        run("s_path", rig=path, cycle__half_periods=4)  # quicker to check
    lines = str(told.value).splitlines()
    assert any(line.startswith("card Dev1:") for line in lines)
    assert any(line.startswith("magnet stage") and "/nowhere/tty" in line for line in lines)
