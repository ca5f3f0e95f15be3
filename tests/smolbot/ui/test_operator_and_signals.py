"""Signals, keys and questions, in processes of their own: what a person or a system does to a run from outside."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import textwrap

import pytest

from smolbot.core.operator import SilentOperator, TerminalOperator
from smolbot.errors import RigError
from smolbot.ui.cli.stop_key import Keyboard

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals and terminals of POSIX")

SHORT = ["--set", "path.points_mm=[[-1, 0], [1.5, 0]]", "--set", "localization.estimator=paper", "--no-report",
         "--force", "preview"]  # fmt: skip

# `smolbot run` that is hit by signals: in the n-th cycle, while outputs go to zero, while the folder is written.
HIT = """
import os, signal, sys
from smolbot.ui.cli import progress
from smolbot.ui.cli.app import main
from smolbot.runs.folder import RunFolder
from sim.tank.rig import TankRig

first, later = signal.Signals[sys.argv[1]], signal.Signals[sys.argv[2]]
told = {"cycles": 0, "zeroed": 0, "written": 0}

def cycle(self, record):
    told["cycles"] += 1
    if told["cycles"] == 5:
        os.kill(os.getpid(), first)

def stop(self, own=TankRig.stop):
    os.kill(os.getpid(), later)
    own(self)
    told["zeroed"] += 1

def end(self, summary, own=RunFolder.end):
    os.kill(os.getpid(), later)
    own(self, summary)
    told["written"] += 1

progress.PathProgress.__call__, TankRig.stop, RunFolder.end = cycle, stop, end
try:
    sys.argv[1:] = sys.argv[3:]
    main()
finally:
    print(told, file=sys.stderr)
"""


@pytest.mark.parametrize(
    ("first", "later", "words"),
    [("SIGTERM", "SIGINT", "(SIGTERM)"), ("SIGINT", "SIGINT", "(Ctrl-C)")],
)
def test_a_signal_stops_a_run_with_3_and_no_second_one_keeps_it_from_its_end(tmp_path, first, later, words):
    out = tmp_path / "run"
    command = [sys.executable, "-c", HIT, first, later, "run", "line", "--out", str(out), *SHORT]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 3, done.stderr
    summary = json.loads((out / "summary.json").read_text())
    assert summary["status"] == "stopped"
    assert words in summary["stop_reason"]
    assert words in done.stdout
    assert len((out / "cycles.csv").read_text().splitlines()) == 1 + summary["cycles"]
    assert (out / "path.png").is_file()
    assert "already stopping" in done.stderr
    assert "'cycles': 5" in done.stderr
    assert "'written': 1" in done.stderr
    assert "'zeroed': 0" not in done.stderr


def test_a_signal_before_the_rig_is_open_moves_nothing_and_ends_with_3(tmp_path):
    script = """
    import os, signal, sys
    from sim import TankWorld
    from smolbot.ui.cli.app import main
    TankWorld.open = staticmethod(lambda *_, **__: os.kill(os.getpid(), signal.SIGTERM))
    sys.argv[1:] = ["run", "line", "--force", "preview", "--out", sys.argv[1]]
    main()
    """
    command = [sys.executable, "-c", textwrap.dedent(script), str(tmp_path / "run")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stderr.strip()) == (3, "stopped by a signal (SIGTERM); nothing was moving")


def test_handlers_are_as_before_once_a_run_is_over():
    import signal
    import threading

    from smolbot.flight.safety.stop_latch import Latch
    from smolbot.flight.safety.stop_signals import catch_stop_signals

    before = signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)
    with catch_stop_signals(Latch()):
        assert signal.getsignal(signal.SIGTERM) != before[0]
    assert (signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)) == before
    failures = []

    def elsewhere():
        try:
            with catch_stop_signals(Latch()):
                pass
        except ValueError as error:
            failures.append(error)

    thread = threading.Thread(target=elsewhere)
    thread.start()
    thread.join()
    assert failures == []


class Terminal:
    """A process on a terminal of its own: what it writes there is waited for, and what is typed it reads."""

    def __init__(self, *command: str) -> None:
        import pty

        self.pid, self.fd = pty.fork()
        if self.pid == 0:
            os.environ["TERM"] = "xterm"
            os.execv(command[0], command)
        self.said = ""
        self._unread = ""

    def until(self, words: str) -> str:
        """Read until `words` were written; what was since the last time."""
        import select

        said, self._unread = self._unread, ""
        while words not in said:
            assert select.select([self.fd], [], [], 60.0)[0], f"waited for {words!r}; got {said!r}"
            try:
                read = os.read(self.fd, 4096)
            except OSError:  # the terminal's other end was closed
                read = b""
            assert read, f"ended before {words!r}; got {said!r}"
            self.said += (new := read.decode(errors="replace"))
            said += new
        said, words, self._unread = said.partition(words)
        return said + words

    def type(self, keys: bytes) -> None:
        os.write(self.fd, keys)

    def modes(self):
        import termios

        return termios.tcgetattr(self.fd)

    def end(self) -> int:
        """Exit code, once all was read."""
        try:
            while read := os.read(self.fd, 4096):
                self.said += read.decode(errors="replace")
        except OSError:
            pass
        _, status = os.waitpid(self.pid, 0)
        os.close(self.fd)
        return os.waitstatus_to_exitcode(status)


def on_a_terminal(script: str) -> Terminal:
    return Terminal(sys.executable, "-c", textwrap.dedent(script))


KEYS = """
    import sys, termios, threading
    from smolbot.ui.cli.stop_key import Keyboard

    pressed = threading.Event()
    kept = termios.tcgetattr(0)
    try:
        with Keyboard(pressed.set) as keyboard:
            print("ready" if keyboard.active else "no terminal", flush=True)
            pressed.wait(30)
            print("pressed" if pressed.is_set() else "nothing", flush=True)
            if len(sys.argv) > 1:
                raise RuntimeError("an error on the way")
    finally:
        print("as before" if termios.tcgetattr(0) == kept else "spoilt", flush=True)
"""


@pytest.mark.parametrize("key", [b"q", b"Q", b"\x1b"])
def test_a_stop_key_is_heard_without_enter_and_the_terminal_is_left_as_it_was(key):
    terminal = on_a_terminal(KEYS)
    terminal.until("ready")
    terminal.type(b"x \n\x1b[A")  # neither other keys nor an arrow stop anything
    terminal.type(key)
    terminal.until("pressed")
    assert terminal.end() == 0
    assert "as before" in terminal.said


def test_the_terminal_is_restored_after_an_error():
    terminal = Terminal(sys.executable, "-c", textwrap.dedent(KEYS), "fail")
    terminal.until("ready")
    terminal.type(b"q")
    terminal.until("as before")
    assert terminal.end() == 1


def test_without_a_terminal_there_is_no_key_and_no_harm():
    read, write = os.pipe()
    with Keyboard(lambda: None, number=read) as keyboard:
        assert not keyboard.active
        with keyboard.pause():
            pass
    os.close(read)
    os.close(write)


def test_a_key_stops_a_run_on_a_terminal_with_3(tmp_path):
    terminal = Terminal(
        sys.executable, "-m", "smolbot", "run", "r_path", "--out", str(tmp_path / "run"), "--no-report",
        "--set", "path.glyph='8'", "--force", "preview",
    )  # fmt: skip
    terminal.until("q, Esc or Ctrl-C stops the run")
    terminal.type(b"q")
    assert terminal.end() == 3
    summary = json.loads((tmp_path / "run/summary.json").read_text())
    assert summary["stop_reason"] == "stopped by the operator (key)"
    assert "stopped by the operator (key)" in terminal.said


ASK = """
    import os, sys
    from smolbot.config.load import load_mission
    from smolbot.ui.cli.progress import show_progress
    from smolbot.ui.cli.stop_key import Keyboard
    from smolbot.core.operator import TerminalOperator

    operator = TerminalOperator()
    with show_progress(load_mission("line")) as progress, Keyboard(lambda: print("key", flush=True)) as keyboard:
        operator.pauses += [progress.pause, keyboard.pause]
        print("ready", flush=True)
        for where in ("near", "away", "again"):
            print(where, operator.ask(f"Bring the magnet {where}", 30.0), flush=True)
        print("over", flush=True)
"""


def test_a_question_steps_out_of_the_progress_and_is_answered_on_the_terminal():
    terminal = on_a_terminal(ASK)
    terminal.until("Bring the magnet near  [Enter: done, q: abort, 30 s]")
    terminal.type(b"\n")
    terminal.until("near True")
    terminal.until("Bring the magnet away")
    terminal.type(b"what?\n")
    terminal.until("'what?' is neither")
    terminal.type(b"q\n")
    terminal.until("away False")
    terminal.until("Bring the magnet again")
    terminal.type(b"done\n")
    terminal.until("over")
    assert terminal.end() == 0
    assert "key" not in terminal.said.replace("Keyboard", "")  # an answer of q is no stop key


def test_what_was_typed_before_the_question_is_no_answer():
    script = """
    from smolbot.errors import RigError
    from smolbot.core.operator import TerminalOperator
    print("typed", input() == "first", flush=True)
    try:
        TerminalOperator().ask("Bring the magnet near", 0.2)
    except RigError as error:
        print(error, flush=True)
    """
    terminal = on_a_terminal(script)
    terminal.type(b"first\n\n\n")
    terminal.until("typed True")
    terminal.until("The operator did not answer within 0.2 s: 'Bring the magnet near'.")
    assert terminal.end() == 0


def piped(text: str):
    read, write = os.pipe()
    os.write(write, text.encode())
    os.close(write)
    return os.fdopen(read)


@pytest.mark.parametrize("source", [piped, io.StringIO])
def test_lines_that_come_from_elsewhere_answer_one_question_each(source):
    out = io.StringIO()
    operator = TerminalOperator(source("\nQ\nyes\n\n"), out)
    assert [operator.ask("Now?", 5.0) for _ in range(4)] == [True, False, True, True]
    with pytest.raises(RigError, match="Nobody can answer 'Now\\?': standard input has ended"):
        operator.ask("Now?", 5.0)
    assert out.getvalue().count("Now?") == 5


def test_a_switch_answers_where_nobody_does():
    asked = []

    def near():
        asked.append(1)
        return len(asked) > 3

    assert TerminalOperator(piped(""), io.StringIO()).ask("Bring it near", 30.0, near)
    asked.clear()
    assert SilentOperator().ask("Bring it near", 30.0, near)
    with pytest.raises(RigError, match="No operator is present to ask: 'Bring it near'"):
        SilentOperator().ask("Bring it near", 30.0)
    for operator in (SilentOperator(), TerminalOperator(piped(""), io.StringIO())):
        with pytest.raises(RigError, match=r"0\.01 s"):
            operator.ask("Bring it near", 0.01, lambda: False)


def test_a_question_is_over_at_once_when_its_switch_says_that_the_rig_was_stopped():
    def stopped():
        raise RigError("stopped")

    with pytest.raises(RigError, match="stopped"):
        TerminalOperator(piped("\n"), io.StringIO()).ask("Bring it near", 30.0, stopped)


def test_the_operator_reaches_the_world(monkeypatch):
    from sim.tank.world import TankWorld
    from smolbot.config.load import load_mission
    from smolbot.flight.session import fly

    class SeenError(Exception):
        pass

    def look(*_, operator, **__):
        raise SeenError(operator)

    monkeypatch.setattr(TankWorld, "open", staticmethod(look))
    mine = TerminalOperator()
    with pytest.raises(SeenError) as caught:
        fly(load_mission("line"), operator=mine)
    assert caught.value.args == (mine,)
    with pytest.raises(SeenError) as caught:
        fly(load_mission("line"))
    assert isinstance(caught.value.args[0], SilentOperator)
