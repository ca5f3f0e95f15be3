"""Every example runs as a newcomer would start it, in an empty folder; those of a notebook are ten lines at most."""

from __future__ import annotations

import os
import subprocess
import sys
import tokenize
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
OF_A_NOTEBOOK = ("mission", "study_of_20_flights", "tuning", "replay_other_estimator", "own_array")


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs_to_its_end(example, tmp_path):
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg"}
    command = [sys.executable, "-P", "-W", "error::DeprecationWarning:__main__", str(example)]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout


@pytest.mark.parametrize("name", OF_A_NOTEBOOK)
def test_what_a_notebook_needs_is_ten_lines(name):
    with (ROOT / "examples" / f"{name}.py").open(encoding="utf-8") as file:
        tokens = list(tokenize.generate_tokens(file.readline))
    not_code = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.STRING, tokenize.ENDMARKER)
    assert len({t.start[0] for t in tokens if t.type not in not_code}) <= 10
