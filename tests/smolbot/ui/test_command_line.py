"""The command line: exit codes, one message for bad input, nothing written or moved because of it."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from smolbot.config.library import list_shipped
from smolbot.errors import RigError
from smolbot.flight import session as flying
from smolbot.ui.cli import app as command_line

SHORT = ["--set", "path.points_mm=[[-1.0, 0.0], [1.0, 0.0]]", "--set", "start.offset_mm=[-0.3, 0.2]",
         "--set", "localization.estimator=paper"]  # fmt: skip
PLAIN = [*SHORT, "--no-report"]


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


def test_a_flown_mission_ends_with_0_a_table_and_a_folder(smolbot, tmp_path):
    code, out, _ = smolbot("run", "line", "--seed", "3", *SHORT)
    assert code == 0
    assert "completed: path's end reached" in out
    folders = list((tmp_path / "runs").iterdir())
    assert len(folders) == 1
    assert re.fullmatch(r"line-\d{8}-\d{6}-seed3", folders[0].name)
    assert (folders[0] / "path.png").is_file()


def test_json_is_one_object_on_standard_output_and_the_table_goes_elsewhere(smolbot, tmp_path):
    code, out, err = smolbot("run", "line", "--seed", "3", "--json", "--out", str(tmp_path / "here"), *PLAIN)
    summary = json.loads(out)
    assert code == 0
    assert summary["verdict"] == "passed"
    assert summary["run"] == str(tmp_path / "here")
    assert summary == json.loads((tmp_path / "here/summary.json").read_text())
    assert "verdict" in err


@pytest.mark.parametrize(
    "setting", ["stop.max_duration_s=1", "verdict.mean_tracking_mm=0.001", "verdict.mean_localization_mm=0.001"]
)
def test_a_verdict_that_failed_ends_with_1(smolbot, setting):
    code, out, _ = smolbot("run", "line", "--seed", "3", *PLAIN, "--set", setting, "--force", "preview")
    assert code == 1
    assert "failed; " in out


def test_ctrl_c_ends_with_3_and_leaves_the_folder(smolbot, monkeypatch, tmp_path):
    from smolbot.ui.cli import progress

    calls = []

    def interrupt(self, record):
        calls.append(record)
        if len(calls) == 4:
            raise KeyboardInterrupt

    monkeypatch.setattr(progress.PathProgress, "__call__", interrupt)
    code, out, _ = smolbot("run", "line", "--out", "stopped", *PLAIN, "--force", "preview")
    assert code == 3
    assert "stopped by the operator" in out
    assert json.loads((tmp_path / "stopped/summary.json").read_text())["cycles"] == 4


def test_a_rig_that_fails_ends_with_3(smolbot, monkeypatch):
    from sim.tank.rig import TankRig

    def fail(self, shot):
        raise RigError("the amplifier tripped")

    monkeypatch.setattr(TankRig, "play", fail)
    code, out, _ = smolbot("run", "line", *PLAIN, "--force", "preview")
    assert code == 3
    assert "failed: the amplifier tripped" in out


def test_a_rig_that_does_not_open_ends_with_3_and_leaves_nothing(smolbot, monkeypatch, tmp_path):
    def refuse(*_, **__):
        raise RigError("no amplifier answers")

    monkeypatch.setattr("sim.tank.world.TankWorld.open", refuse)
    code, _, err = smolbot("run", "line", *SHORT, "--force", "preview")
    assert code == 3
    assert err.strip() == "no amplifier answers"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["r_smal"], ["No mission is named 'r_smal'", "Did you mean r_small?"]),
        (["./nowhere.toml"], ["nowhere.toml: no such file"]),
        (["line", "--rig", "moonbase"], ["No rig is named 'moonbase'", "tank"]),
        (["line", "--set", "controller.tolerence_mm=0.5"], ["Did you mean tolerance_mm?"]),
        (["line", "--set", "controller.tolerance_mm"], ["--set needs key=value"]),
        (["line", "--set", "controller.tolerance_mm=0.05"], ["localization error to be expected"]),
        (["line", "--set", "controller.law=magic"], ["no controller is named 'magic'", "current_ratio"]),
        (["line", "--set", "rig.world=moon"], ["no world is named 'moon'"]),
        (["line", "--set", "path.points_mm=[[0, 0], [30, 0]]"], ["outside the tank", "outside the field table"]),
        (["line", "--set", "rig.table.x_mm=[-3, 3]"], ["outside the field table"]),
    ],
)
@pytest.mark.parametrize("command", ["run", "preview", "simulate"])
def test_bad_input_ends_with_2_one_message_and_nothing_written(smolbot, tmp_path, command, arguments, words):
    extra = ["--seeds", "1..2", "--jobs", "1"] if command == "simulate" else []
    code, out, err = smolbot(command, *arguments, *extra)
    assert code == 2
    for word in words:
        assert word in err
    assert out == ""
    assert list(tmp_path.iterdir()) == []


def test_a_run_folder_in_use_ends_with_2(smolbot, tmp_path):
    (tmp_path / "used").mkdir()
    (tmp_path / "used/notes.txt").write_text("mine")
    code, _, err = smolbot("run", "line", "--out", "used", *SHORT)
    assert code == 2
    assert "not empty" in err
    assert [p.name for p in (tmp_path / "used").iterdir()] == ["notes.txt"]


def test_a_spoiled_table_ends_with_2_and_its_place(smolbot, tmp_path):
    rig = list_shipped("rigs")["tank"].read_text()
    start, end = rig.index("[table]"), rig.index("[container]")
    (tmp_path / "rig.toml").write_text(f'{rig[:start]}[table]\nfile = "coils.txt"\n\n{rig[end:]}')
    (tmp_path / "coils.txt").write_text("% x y z\n1 2 NaN\n")
    before = sorted(p.name for p in tmp_path.iterdir())
    for command in ("run", "preview"):
        code, _, err = smolbot(command, "line", "--rig", "./rig.toml")
        assert code == 2
        assert "coils.txt" in err
    assert sorted(p.name for p in tmp_path.iterdir()) == before


def test_all_faults_of_the_files_are_told_at_once(smolbot, tmp_path):
    text = list_shipped("missions")["line"].read_text()
    for old, new in (
        ("tolerance_mm", "tolerence_mm"),
        ("excite_cycles = 5", "excite_cycles = 0"),
        ("[verdict]", "[vredict]"),
    ):
        text = text.replace(old, new, 1)
    (tmp_path / "mine.toml").write_text(text)
    code, _, err = smolbot("preview", "./mine.toml")
    assert code == 2
    assert len([line for line in err.splitlines() if line.startswith("mine.toml:")]) == 3


def test_preview_ends_with_0_for_go_and_1_for_no_go(smolbot, missions):
    code, out, _ = smolbot("preview", "line", "--json")
    seen = json.loads(out)
    assert code == 0
    assert seen["go"] is True
    assert seen["reasons"] == []
    assert 9.0 < seen["loop_rate_hz"] < seen["timeline_limit_hz"] < 9.35
    assert seen["path_length_mm"] == pytest.approx(8.0)
    code, out, _ = smolbot("preview", str(missions / "too_slow.toml"))
    assert code == 1
    assert "no-go: it would not end within max_duration_s" in out


def test_preview_of_an_unfit_mission_says_no_go_in_json_too(smolbot, missions):
    code, out, err = smolbot("preview", str(missions / "tolerance_under_error.toml"), "--json")
    assert code == 2
    assert json.loads(out)["go"] is False
    assert "localization error" in json.loads(out)["reasons"][0]
    assert "no-go" in err


def test_list_names_what_is_shipped_and_installed(smolbot):
    code, out, _ = smolbot("list", "--json")
    listed = json.loads(out)
    assert code == 0
    assert set(listed["missions"]) >= {"line", "r_small"}
    assert set(listed["rigs"]) >= {"tank"}
    assert "current_ratio" in listed["controllers"]


def test_init_copies_a_mission_that_previews_as_it_stands(smolbot, tmp_path):
    code, _, _ = smolbot("init", "mine", "--mission", "line")
    assert code == 0
    assert {p.name for p in (tmp_path / "mine").iterdir()} == {"line.toml", "tank.toml", "gradient.toml"}
    assert smolbot("preview", "mine/line.toml")[0] == 0
    code, _, err = smolbot("init", "mine", "--mission", "line")
    assert code == 2
    assert "nothing was written" in err
    code, _, err = smolbot("init", "other", "--mission", "nothing")
    assert code == 2
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize(
    "arguments", [["run"], ["fly", "line"], ["run", "line", "--seed", "-1"], ["run", "line", "--x"]]
)
def test_a_command_that_is_none_ends_with_2(smolbot, arguments):
    assert smolbot(*arguments)[0] == 2


def test_studies_fly_every_seed_and_leave_their_results(smolbot, tmp_path):
    code, out, _ = smolbot("simulate", "line", "--seeds", "3..4", "--jobs", "1", "--json", "--out", "study", *SHORT)
    figures = json.loads(out)
    assert code == 0
    assert (figures["flown"], figures["passed"]) == (2, 2)
    rows = (tmp_path / "study/results.csv").read_text().splitlines()
    assert len(rows) == 3
    assert [row.split(",")[0] for row in rows[1:]] == ["3", "4"]
    for seeds in ("4..3", "a..b", "-1..2"):
        assert smolbot("simulate", "line", f"--seeds={seeds}")[0] == 2


def test_the_installed_command_ends_with_its_code(tmp_path):
    """Once as a process of its own, through the console script's entry point."""
    script = "import sys; from smolbot.ui.cli.app import main; sys.argv = ['smolbot', 'preview', 'r_smal']; main()"
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stdout == ""
    assert len(done.stderr.strip().splitlines()) == 1
    assert "Traceback" not in done.stderr


def test_new_run_folders_never_share_a_name(line, tmp_path):
    first = flying.make_run_folder(line, 1, tmp_path)
    first.path.mkdir(exist_ok=True, parents=True)
    assert flying.make_run_folder(line, 1, tmp_path).path != first.path
    assert Path(first.path).parent == tmp_path
