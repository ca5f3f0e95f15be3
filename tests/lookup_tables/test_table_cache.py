"""The cache gives the table that was asked for, or builds it."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

from lookup_tables import cache, cached_table
from lookup_tables.cache import default_cache_dir, table_key

AXES = (np.linspace(-0.002, 0.002, 3), np.linspace(-0.002, 0.002, 3), np.array([0.0]))


@pytest.fixture
def builds(monkeypatch):
    """Counts how often a table was computed."""
    calls = []
    original = cache.build
    monkeypatch.setattr(cache, "build", lambda *args: calls.append(args) or original(*args))
    return calls


def test_the_second_call_reads_what_the_first_built(coils, tmp_path, builds):
    first = cached_table(coils, *AXES, cache_dir=tmp_path)
    second = cached_table(coils, *AXES, cache_dir=tmp_path)
    assert len(builds) == 1
    np.testing.assert_array_equal(first.samples, second.samples)
    np.testing.assert_array_equal(first.spline.coefficients, second.spline.coefficients)
    assert [p.suffix for p in tmp_path.iterdir()] == [".npz"]  # no temporary file is left


def test_whatever_changes_the_field_changes_the_key(coils):
    keys = {table_key(coils, *AXES), table_key(coils[::-1], *AXES), table_key(coils, AXES[0], AXES[1], AXES[2] + 1e-6)}
    for change in ({"name": "a"}, {"center": (0, 0, 0.06)}, {"axis": (0, 0, 1)}, {"turns": 201}, {"length": 0.021}):
        keys.add(table_key([replace(coils[0], **change), *coils[1:]], *AXES))
    assert len(keys) == 8


def test_a_corrupt_file_is_built_anew(coils, tmp_path, builds):
    cached_table(coils, *AXES, cache_dir=tmp_path)
    (file,) = tmp_path.iterdir()
    whole = file.read_bytes()
    for broken in (b"", b"nonsense", whole[: len(whole) // 2], whole.replace(b"potential", b"potentiel")):
        file.write_bytes(broken)
        cached_table(coils, *AXES, cache_dir=tmp_path)
    assert len(builds) == 5
    assert len(file.read_bytes()) == len(whole)


def test_a_folder_that_cannot_be_written_warns_once_and_builds(coils, tmp_path, builds):
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    with pytest.warns(RuntimeWarning, match="cannot be kept in .*SMOLBOT_CACHE names another folder"):
        cached_table(coils, *AXES, cache_dir=blocked / "cache")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cached_table(coils, *AXES, cache_dir=blocked / "cache")
    assert len(builds) == 2


def test_a_failed_write_leaves_nothing_behind(coils, tmp_path, monkeypatch):
    def full_disk(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(cache.os, "replace", full_disk)
    with pytest.warns(RuntimeWarning, match="No space left"):
        cached_table(coils, *AXES, cache_dir=tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_the_folder_is_the_users_choice(monkeypatch, tmp_path):
    monkeypatch.delenv("SMOLBOT_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    if cache.sys.platform != "win32":
        assert default_cache_dir() == tmp_path / "xdg" / "smolbot"
    monkeypatch.setenv("SMOLBOT_CACHE", str(tmp_path / "mine"))
    assert default_cache_dir() == tmp_path / "mine"
