"""The tutorials' runner: what it takes for granted, what it refuses, and where it says a page is wrong."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"


def load():
    spec = importlib.util.spec_from_file_location("run_tutorials", DOCS / "run_tutorials.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["run_tutorials"] = module
    spec.loader.exec_module(module)
    return module


runner = load()
NAMES = sorted(page.stem for page in (DOCS / "tutorials").glob("*.md") if page.stem != "index")

PAGE = """# A page

**`notes/list.txt`**

```text
one
two
```

**`notes/list.txt`**

```diff
 one
-two
+three
```

```console
$ cd notes
$ wc -l < list.txt; \\
> cat list.txt
2
one
…
$ false   # exits with 1
$ export LAST=$(tail -1 list.txt)
$ echo "in $(basename $PWD): $LAST, 0.40"
in notes: three, 0.31
```
"""


def test_a_page_is_played_in_one_shell_and_its_files_are_written_and_changed(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(PAGE, encoding="utf-8")
    runner.play(page, tmp_path / "scratch")
    assert (tmp_path / "scratch" / "work" / "notes" / "list.txt").read_text() == "one\nthree\n"


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("in notes: three, 0.31", "in notes: three, 0.91", 27, "and not, as the page shows"),
        ("in notes: three, 0.31", "in notes: four, 0.31", 27, "and not, as the page shows"),
        ("$ false   # exits with 1", "$ false", 25, "exits with 1, not 0"),
        ("-two", "-four", 12, "occur in the file 0 times"),
        ("**`notes/list.txt`**\n\n```diff", "```diff", 10, "needs the name of its file"),
        ("```console", "```python", 18, "a block of 'python' needs the name"),
        ("2\none\n…", "2\none", 20, "and not, as the page shows"),
    ],
)
def test_what_does_not_hold_is_reported_with_its_line(tmp_path, old, new, line, said):
    page = tmp_path / "page.md"
    page.write_text(PAGE.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(runner.TutorialError, match=said) as caught:
        runner.play(page, tmp_path / "scratch")
    assert caught.value.line == line


def test_a_page_that_does_not_hold_fails_the_run_with_page_and_line(tmp_path, monkeypatch, capsys):
    (tmp_path / "wrong.md").write_text("# Wrong\n\n```console\n$ exit_code_of_nothing_there\n```\n", encoding="utf-8")
    (tmp_path / "right.md").write_text("# Right\n\n```console\n$ echo ok\nok\n```\n", encoding="utf-8")
    monkeypatch.setattr(runner, "PAGES", tmp_path)
    assert runner.main([]) == 1
    said = capsys.readouterr()
    assert f"{tmp_path / 'wrong.md'}:4: 'exit_code_of_nothing_there' exits with 127, not 0" in said.err
    assert "right: " in said.out


def test_what_a_page_leaves_running_ends_with_it(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("```console\n$ sleep 600 &\n$ echo $! > pid\n```\n", encoding="utf-8")
    runner.play(page, tmp_path / "scratch")
    pid = int((tmp_path / "scratch" / "work" / "pid").read_text())
    state = Path(f"/proc/{pid}/stat")
    assert not state.exists() or state.read_text().split()[2] == "Z"


@pytest.mark.parametrize("name", NAMES)
def test_every_page_can_be_read(name):
    steps = list(runner.read_steps((DOCS / "tutorials" / f"{name}.md").read_text(encoding="utf-8")))
    assert any(isinstance(step, runner.Command) and step.shown for step in steps)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in NAMES if name != "the_twin"])
def test_a_reader_can_follow(name, tmp_path):
    runner.play(DOCS / "tutorials" / f"{name}.md", tmp_path)


@pytest.mark.slow
@pytest.mark.realtime
def test_a_reader_can_follow_on_the_twin(tmp_path):
    runner.play(DOCS / "tutorials" / "the_twin.md", tmp_path)
