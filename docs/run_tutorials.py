"""Run the tutorials as their reader would: every command in an empty directory, every shown output compared.

    python docs/run_tutorials.py [PAGE ...] [--quick] [--keep DIR] [--show]

What a page's fenced blocks mean:

- ``console``: lines after ``$ `` are commands for one bash per page. What is shown below a command must be what it
  prints; ``…`` stands for anything within a line, a line of ``…`` for any lines, and a number with a decimal point for
  any within half of its size, as the figures of a flight differ from machine to machine. A command must exit with 0, or
  with N where ``# exits with N`` stands behind it. Without shown output only the exit code counts.
- A block under a line that holds nothing but the name of a file in bold code: a file that the reader writes.
- ``diff`` under such a line: a change to a file; its old lines must occur there exactly once.
- ``sh``, ``text`` without one: to read only. Any other block is an error.

A page with ``slow_tutorial: true`` in its front matter is left out by ``--quick``. `pip install` reaches a layer of its
own over the environment that runs this, so that nothing of a tutorial is left in it.
"""

from __future__ import annotations

import argparse
import os
import re
import selectors
import signal
import subprocess
import sys
import sysconfig
import tempfile
import time
import venv
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

PAGES = Path(__file__).parent / "tutorials"
TIMEOUT = 300.0
"""Of one command, in s."""

_FENCE = re.compile(r"^(`{3,})(\S.*)?$")
_NAME = re.compile(r"^\*\*`(.+)`\*\*$")
_EXITS = re.compile(r"#\s*exits with (\d+)\s*$")
_DECIMAL = re.compile(r"(?<![\d.])-?\d+\.\d+(?![\d.])")
_DONE = "\x1e--tutorial--"


class TutorialError(Exception):
    """Something that a page shows does not hold.

    Parameters
    ----------
    line : int
        Of the page.
    message : str
    """

    def __init__(self, line: int, message: str) -> None:
        super().__init__(message)
        self.line = line


@dataclass(frozen=True)
class Command:
    """One command of a console block, the lines that are shown of its output, and its exit code."""

    line: int
    text: str
    shown: tuple[str, ...]
    code: int


@dataclass(frozen=True)
class File:
    """A file that the reader writes, or changes where `diff`."""

    line: int
    name: str
    text: str
    diff: bool


Step = Command | File


def read_steps(page: str) -> Iterator[Step]:
    """Read what the reader of a page does, in order.

    Parameters
    ----------
    page : str
        Markdown.

    Yields
    ------
    Command or File
    """
    lines = page.splitlines()
    number = 0
    while number < len(lines):
        fence = _FENCE.match(lines[number])
        if fence is None or not fence[2]:
            number += 1
            continue
        end = next((i for i in range(number + 1, len(lines)) if lines[i].rstrip() == fence[1]), None)
        if end is None:
            raise TutorialError(number + 1, "this block has no end.")
        above = next((text for text in reversed(lines[:number]) if text), "")
        named = _NAME.match(above)
        yield from _block(fence[2].strip(), named[1] if named else "", lines[number + 1 : end], number + 1)
        number = end + 1


def _block(info: str, name: str, body: list[str], line: int) -> Iterator[Step]:
    if info == "console":
        yield from _commands(body, line)
    elif name:
        yield File(line, name, "\n".join(body).strip("\n") + "\n", info == "diff")
    elif info not in ("sh", "text"):
        raise TutorialError(line, f"a block of '{info}' needs the name of its file above it: **`NAME`**.")


def _commands(body: list[str], line: int) -> Iterator[Command]:
    text: str | None = None
    shown: list[str] = []
    started = line
    for offset, row in enumerate(body, 1):
        if text is not None and text.endswith("\\"):
            text += "\n" + row.removeprefix("> ")
        elif row.startswith("$ "):
            if text is not None:
                yield _command(started, text, shown)
            started, text, shown = line + offset, row[2:], []
        elif text is None:
            raise TutorialError(line + offset, "a console block begins with '$ ' and a command.")
        else:
            shown.append(row)
    if text is not None:
        yield _command(started, text, shown)


def _command(line: int, text: str, shown: list[str]) -> Command:
    exits = _EXITS.search(text)
    return Command(line, text, tuple(shown), int(exits[1]) if exits else 0)


def matches(shown: Sequence[str], printed: str) -> bool:
    r"""Tell whether shown lines are what was printed; runs of spaces count as one.

    Parameters
    ----------
    shown : sequence of str
        Lines of the page.
    printed : str

    Returns
    -------
    bool

    Examples
    --------
    >>> matches(["status   done: …"], "status done: path's end reached\n")
    True
    >>> matches(["…", "last"], "first\nsecond\nlast\n"), matches(["last"], "first\nlast\n")
    (True, False)
    >>> matches(["mean 0.31 mm"], "mean 0.40 mm"), matches(["mean 0.31 mm"], "mean 0.80 mm")
    (True, False)
    """
    pattern, numbers = "", []
    for line in shown:
        if line.strip() == "…":
            pattern += r"(?:[^\n]*\n)*?"
            continue
        parts = [" ".join(part.split()) for part in line.strip().split("…")]
        numbers += [number for part in parts for number in _DECIMAL.findall(part)]
        pattern += r"\ ?[^\n]*?\ ?".join(_open(part) for part in parts) + r"\n"
    found = "".join(" ".join(line.split()) + "\n" for line in printed.splitlines())
    match = re.fullmatch(pattern, found)
    return match is not None and all(_near(*pair) for pair in zip(numbers, match.groups(), strict=True))


def _open(text: str) -> str:
    """A pattern for `text` in which every number with a decimal point is caught."""
    return r"(-?\d+(?:\.\d+)?)".join(re.escape(piece) for piece in _DECIMAL.split(text))


def _near(shown: str, printed: str) -> bool:
    """Within half of the size, or a unit of the last digit."""
    unit = 10.0 ** -len(shown.partition(".")[2])
    return abs(float(printed) - float(shown)) <= max(0.5 * abs(float(shown)), 1.5 * unit)


def apply(diff: str, text: str) -> str:
    """Apply a change to a text.

    Parameters
    ----------
    diff : str
        The change, as the page shows it.
    text : str

    Returns
    -------
    str

    Raises
    ------
    ValueError
        If the old lines do not occur in it exactly once.
    """
    rows = diff.splitlines()
    old = "\n".join(row[1:] for row in rows if row[:1] in ("-", " ") or not row)
    new = "\n".join(row[1:] for row in rows if row[:1] in ("+", " ") or not row)
    if text.count(old) != 1:
        raise ValueError(f"the old lines occur in the file {text.count(old)} times, not once:\n{old}")
    return text.replace(old, new)


class Shell:
    """One bash, whose commands are run one after the other.

    Parameters
    ----------
    folder : Path
        Working directory.
    path : str
        Value of PATH.
    """

    def __init__(self, folder: Path, path: str) -> None:
        environment = {
            **os.environ, "PATH": path, "HOME": str(folder.parent / "home"), "NO_COLOR": "1",
            "PYTHONWARNINGS": "ignore",
            "PIP_NO_INDEX": "1", "PIP_NO_BUILD_ISOLATION": "0", "PIP_DISABLE_PIP_VERSION_CHECK": "1",
        }  # fmt: skip
        environment.pop("VIRTUAL_ENV", None)
        environment.setdefault("SMOLBOT_CACHE", str(Path.home() / ".cache" / "smolbot"))
        self._process = subprocess.Popen(
            ["bash", "--norc", "--noprofile"],
            cwd=folder, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            start_new_session=True,
        )  # fmt: skip

    def run(self, command: str) -> tuple[int, str]:
        """Run a command.

        Parameters
        ----------
        command : str

        Returns
        -------
        tuple of int and str
            Exit code, and output.

        Raises
        ------
        TimeoutError
            If it takes longer than `TIMEOUT`.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(f"{{ {command}\n}} </dev/null\nprintf '\\n{_DONE}%d\\n' $?\n".encode())
        self._process.stdin.flush()
        printed = b""
        deadline = time.monotonic() + TIMEOUT
        done = re.compile(rb"\n" + _DONE.encode() + rb"(\d+)\n")
        with selectors.DefaultSelector() as selector:
            selector.register(self._process.stdout, selectors.EVENT_READ)
            while not (found := done.search(printed)):
                if not selector.select(max(deadline - time.monotonic(), 0.0)):
                    raise TimeoutError(f"took longer than {TIMEOUT:g} s")
                piece = os.read(self._process.stdout.fileno(), 65536)
                if not piece:
                    raise TimeoutError("ended the shell")
                printed += piece
        return int(found[1]), printed[: found.start()].decode(errors="replace")

    def close(self) -> None:
        """End the shell and all that it started."""
        for how in (signal.SIGTERM, signal.SIGKILL):
            try:
                os.killpg(self._process.pid, how)
            except ProcessLookupError:
                break
            time.sleep(0.2)
        self._process.wait()


def make_environment(folder: Path) -> str:
    """Make an environment on top of this one.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    str
        The PATH under which its programs are found first.
    """
    venv.create(folder, with_pip=False, symlinks=True)
    below = sysconfig.get_path("purelib")
    inside = Path(sysconfig.get_path("purelib", vars={"base": str(folder)}))
    (inside / "below.pth").write_text(f"import site; site.addsitedir({below!r})\n", encoding="utf-8")
    for name, module in (("smolbot", "smolbot"), ("pip", "pip")):
        program = folder / "bin" / name
        program.write_text(f'#!/bin/sh\nexec "{folder}/bin/python" -P -m {module} "$@"\n', encoding="utf-8")
        program.chmod(0o755)
    return f"{folder / 'bin'}:{Path(sys.executable).parent}:{os.environ['PATH']}"


def play(page: Path, folder: Path, *, show: bool = False) -> None:
    """Do all that a page shows.

    Parameters
    ----------
    page : Path
    folder : Path
        Empty.
    show : bool
        Whether to print what commands print.

    Raises
    ------
    TutorialError
        At the first thing that does not hold.
    """
    work = folder / "work"
    for inner in (work, folder / "home"):
        inner.mkdir(parents=True)
    todo = list(read_steps(page.read_text(encoding="utf-8")))
    shell = Shell(work, make_environment(folder / "environment"))
    try:
        for step in todo:
            if isinstance(step, File):
                _write(step, work)
                continue
            began = time.monotonic()
            try:
                code, printed = shell.run(step.text)
            except TimeoutError as error:
                raise TutorialError(step.line, f"'{step.text}' {error}.") from error
            if show:
                print(f"$ {step.text}\n{printed.rstrip()}\n    [{code}, {time.monotonic() - began:.1f} s]", flush=True)
            if code != step.code:
                raise TutorialError(step.line, f"'{step.text}' exits with {code}, not {step.code}:\n{printed}")
            if step.shown and not matches(step.shown, printed):
                shown = "\n".join(step.shown)
                raise TutorialError(step.line, f"'{step.text}' prints\n{printed}\nand not, as the page shows,\n{shown}")
    finally:
        shell.close()


def _write(step: File, work: Path) -> None:
    target = work / step.name
    if not step.diff:
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(step.text, encoding="utf-8")
        return
    try:
        target.write_text(apply(step.text, target.read_text(encoding="utf-8")), encoding="utf-8")
    except (OSError, ValueError) as error:
        raise TutorialError(step.line, f"{step.name}: {error}") from error


def is_slow(page: Path) -> bool:
    """Tell whether a page declares in its front matter that it takes long.

    Parameters
    ----------
    page : Path

    Returns
    -------
    bool
    """
    head = page.read_text(encoding="utf-8").split("---", 2)
    return len(head) == 3 and head[0] == "" and "slow_tutorial: true" in head[1]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the pages and print how long each took.

    Parameters
    ----------
    arguments : sequence of str, optional
        Default: those of the command line.

    Returns
    -------
    int
        1 if one of them does not hold.
    """
    parser = argparse.ArgumentParser(description="Run the tutorials as their reader would.")
    parser.add_argument("pages", nargs="*", help="names of pages, such as my_own_path; all without")
    parser.add_argument("--quick", action="store_true", help="leave out pages that take long")
    parser.add_argument("--jobs", type=int, default=1, help="how many pages to play beside one another")
    parser.add_argument("--keep", type=Path, help="folder to run in, which stays")
    parser.add_argument("--show", action="store_true", help="print what commands print")
    chosen = parser.parse_args(arguments)
    known = {page.stem: page for page in sorted(PAGES.glob("*.md")) if page.stem != "index"}
    unknown = [name for name in chosen.pages if name not in known]
    if unknown:
        parser.error(f"no tutorial is named {unknown[0]}; there are {', '.join(known)}.")
    pages = [known[name] for name in chosen.pages or known if not (chosen.quick and is_slow(known[name]))]
    with ThreadPoolExecutor(chosen.jobs) as executor:
        wrong = sum(executor.map(lambda page: _fails(page, chosen.keep, chosen.show), pages))
    return 1 if wrong else 0


def _fails(page: Path, keep: Path | None, show: bool) -> bool:
    """Play a page and print how long it took, or what does not hold."""
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as scratch:
        try:
            play(page, (keep or Path(scratch)) / page.stem, show=show)
        except TutorialError as error:
            print(f"{page}:{error.line}: {error}", file=sys.stderr, flush=True)
            return True
    print(f"{page.stem}: {time.monotonic() - began:.1f} s", flush=True)
    return False


if __name__ == "__main__":
    sys.exit(main())
