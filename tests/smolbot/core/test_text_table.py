"""Tables in text: what is read alike, and where a fault is reported."""

from __future__ import annotations

import numpy as np
import pytest

from smolbot.core.text_table import read_table
from smolbot.errors import InputError
from smolbot.runs.optics.optical_track import COLUMNS, NEEDED, read_optical_track

HEAD = ",".join(COLUMNS)


@pytest.mark.parametrize("separator", [",", ";", "\t", " , "])
@pytest.mark.parametrize("begin", ["", "\ufeff", "# a lab\n\n"])
def test_separators_comments_blank_lines_and_byte_order_marks_do_not_matter(tmp_path, separator, begin):
    path = tmp_path / "t.csv"
    path.write_text(begin + "\n".join(separator.join(row) for row in (("x", "y"), ("0.5", "1"), ("-2e1", "3"))) + "\n")
    table = read_table(path)
    assert table.names == ("x", "y")
    np.testing.assert_array_equal([row.parse_finite(("x", "y")) for row in table.rows], [[0.5, 1.0], [-20.0, 3.0]])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("frame,time_s\n0,0\n", r"t\.csv: column x_m, .* is missing; an optical track has frame"),
        (f"{HEAD}\n0,0,0,0,0,0,0,1\n", r"t\.csv: holds 1 rows; a track has two or more"),
        (f"# by another program\n{HEAD}\n0,0,0,0,0,0,0,1\n1,0.1,zero,0,0,0,0,1\n", r"t\.csv:4: x_m is not a number"),
        (f"{HEAD}\n\n0,0,0,0,0,0,0,1\n1,nan,0,0,0,0,0,1\n", r"t\.csv:4: time_s is not a number \('nan'\)"),
        (f"{HEAD}\n0,0,0,0\n", r"t\.csv:2: has 4 columns; the line of names has 8"),
        (f"{HEAD}\n1,0.1,0,0,0,0,0,1\n2,0.1,0,0,0,0,0,1\n", r"t\.csv: time_s must rise from row to row"),
    ],
)
def test_a_bad_optical_track_is_refused_with_file_and_line(tmp_path, text, says):
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(InputError, match=says):
        read_optical_track(tmp_path / "t.csv")


def test_an_optical_track_of_another_program_may_leave_sigma_and_share_out(tmp_path):
    (tmp_path / "t.csv").write_text(f"{';'.join(NEEDED)}\n3;0.5;0.01;0.02;0.06;1\n4;0.6;0.01;0.03;0.06;1\n")
    track = read_optical_track(tmp_path / "t.csv")
    assert np.isnan(track.sigmas).all()
    assert track.positions[1].tolist() == [0.01, 0.03, 0.06]


def test_bytes_that_are_no_text_are_reported(tmp_path):
    (tmp_path / "t.csv").write_bytes(b"x,y\n\xff\xfe0,1\n")
    with pytest.raises(InputError, match=r"t\.csv: cannot be read as text"):
        read_table(tmp_path / "t.csv")
