"""`smolbot table`: one JSON object on stdout, exit code 2 and one message for bad input."""

from __future__ import annotations

import json
import sys
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from lookup_tables import FieldTable
from lookup_tables.plot import plot_table
from smolbot.ui.cli.table import app


def run(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.fixture
def file(table, tmp_path):
    table.write(tmp_path / "t.npz")
    return tmp_path / "t.npz"


def test_info_describes_the_table(file):
    found = json.loads(run("info", file, "--json").stdout)
    assert [coil["name"] for coil in found["coils"]] == ["+x", "-x", "+y", "-y"]
    assert found["mesh"]["x"] == {"low_mm": -8.0, "high_mm": 12.0, "nodes": 21, "step_mm": 1.0}
    assert 0.3 < found["coils"][0]["center_mt_per_a"] < 0.6
    assert found["coils"][0]["curl_residual"] < 1e-6
    assert found["coils"][0]["divergence_residual"] < 1e-4
    people = run("info", file)
    assert people.exit_code == 0
    assert "+x" in people.stdout


def test_import_brings_an_export_to_the_world_frame_and_one_ampere(table, tmp_path):
    table.write(tmp_path / "export.txt", layout="grid")
    out = tmp_path / "world.npz"
    words = (
        "import",
        tmp_path / "export.txt",
        "--out",
        out,
        "--current",
        2,
        "--origin-mm",
        "0,0,60",
        "--names",
        "a,b,c,d",
    )
    assert json.loads(run(*words, "--json").stdout)["out"] == str(out)
    world = FieldTable.read(out)
    assert world.names == ("a", "b", "c", "d")
    assert world.z[0] == pytest.approx(0.057)
    assert world.samples == pytest.approx(table.samples / 2)


def test_build_writes_the_table_of_a_rig(table, tmp_path, monkeypatch):
    rig = SimpleNamespace(load_rig=lambda name: SimpleNamespace(table=lambda: table))
    monkeypatch.setitem(sys.modules, "smolbot.config.rig", rig)
    out = tmp_path / "built.txt"
    result = run("build", "tank", "--out", out, "--layout", "grid", "--json")
    assert json.loads(result.stdout)["source"] == "tank"
    assert FieldTable.read(out).names == table.names
    assert run("plot", "tank", "--out", tmp_path / "t.png").exit_code == 0


def test_plot_draws_a_figure(file, tmp_path):
    result = run("plot", file, "--out", tmp_path / "t.png", "--z-mm", 1, "--current", 8, "--json")
    assert json.loads(result.stdout)["out"].endswith("t.png")
    assert (tmp_path / "t.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("shape", ["one coil", "three coils", "one plane"])
def test_tables_of_other_shapes_are_drawn_too(table, tmp_path, shape):
    n = {"one coil": 1, "three coils": 3, "one plane": 4}[shape]
    z = slice(3, 4) if shape == "one plane" else slice(None)
    part = FieldTable(table.x, table.y, table.z[z], table.samples[:n, :, :, z], table.names[:n])
    plot_table(part, tmp_path / "t.png")
    assert (tmp_path / "t.png").is_file()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("info", "nowhere.txt"), "nowhere.txt: there is no such file"),
        (("import", "FILE", "--out", "o.npz", "--origin-mm", "1,2"), "--origin-mm must be three numbers"),
        (("import", "FILE", "--out", "no/folder/o.npz"), "cannot be written"),
        (("plot", "FILE", "--out", "o.png", "--z-mm", "100"), "is outside the table, which covers x -8 to 12"),
        (("plot", "FILE", "--out", "o.docx"), "the figure cannot be written"),
    ],
)
def test_bad_input_is_one_message_and_exit_code_2(file, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    result = run(*(str(file) if word == "FILE" else word for word in words))
    assert result.exit_code == 2
    assert message in result.stderr
    assert "Traceback" not in result.stderr
    assert result.stdout == ""
