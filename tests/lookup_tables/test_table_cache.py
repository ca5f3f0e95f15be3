"""The cache gives the table that was asked for, or builds it."""

from __future__ import annotations

import os
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from lookup_tables import build, cache, cached_table
from lookup_tables.cache import compute_table_key, get_default_cache_dir

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
    keys = {
        compute_table_key(coils, *AXES),
        compute_table_key(coils[::-1], *AXES),
        compute_table_key(coils, AXES[0], AXES[1], AXES[2] + 1e-6),
    }
    for change in ({"name": "a"}, {"center": (0, 0, 0.06)}, {"axis": (0, 0, 1)}, {"turns": 201}, {"length": 0.021}):
        keys.add(compute_table_key([replace(coils[0], **change), *coils[1:]], *AXES))
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
    with pytest.warns(RuntimeWarning, match="cannot be kept in .*Set SMOLBOT_CACHE to another folder"):
        cached_table(coils, *AXES, cache_dir=blocked / "cache")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cached_table(coils, *AXES, cache_dir=blocked / "cache")
    assert len(builds) == 2


@pytest.fixture
def room_for_two(coils, tmp_path, monkeypatch):
    """A cache that holds two tables like these, and gives the nth of them."""

    def table(n):
        return cached_table(coils, *AXES[:2], np.array([n * 1e-3]), cache_dir=tmp_path)

    table(0)
    (file,) = tmp_path.iterdir()
    monkeypatch.setattr(cache, "MAX_CACHE_BYTES", round(2.5 * file.stat().st_size))
    os.utime(file, (1.0, 1.0))
    return table


def test_the_least_recently_used_table_is_deleted_first(room_for_two, tmp_path, builds):
    room_for_two(1)
    (second,) = (p for p in tmp_path.iterdir() if p.stat().st_mtime > 1.0)
    os.utime(second, (2.0, 2.0))
    room_for_two(0)  # used once more
    room_for_two(2)
    assert sum(p.stat().st_size for p in tmp_path.iterdir()) <= cache.MAX_CACHE_BYTES
    assert not second.exists()
    room_for_two(0)
    assert len(builds) == 2


def test_only_fields_and_abandoned_files_are_deleted(room_for_two, tmp_path):
    now = time.time()
    for name, age in (("heat.json", 2e6), (".table-a.npz", 1.0), (".table-b.npz", 2e6), ("tank-coil-a.npy", 2e6)):
        (tmp_path / name).write_bytes(bytes(cache.MAX_CACHE_BYTES))
        os.utime(tmp_path / name, (now - age, now - age))
    room_for_two(1)
    left = {p.name for p in tmp_path.iterdir()}
    assert {"heat.json", ".table-a.npz"} <= left
    assert not {".table-b.npz", "tank-coil-a.npy"} & left


def test_a_table_larger_than_the_bound_is_kept_alone(room_for_two, tmp_path, monkeypatch, builds):
    monkeypatch.setattr(cache, "MAX_CACHE_BYTES", 1)
    room_for_two(1)
    room_for_two(1)
    assert len(builds) == len(list(tmp_path.iterdir())) == 1


def test_processes_that_write_at_once_leave_one_complete_table(coils, tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "MAX_CACHE_BYTES", 1)  # each deletes what the others keep
    with ThreadPoolExecutor(8) as pool:
        found = list(
            pool.map(lambda n: cached_table(coils, *AXES[:2], np.array([n % 2 * 1e-3]), cache_dir=tmp_path), range(32))
        )
    for n in (0, 1):
        same = {table.spline.coefficients.tobytes() for table in found[n::2]}
        assert same == {build(coils, *AXES[:2], np.array([n * 1e-3])).spline.coefficients.tobytes()}
    assert all(p.name.startswith("table-") for p in tmp_path.iterdir())


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
        assert get_default_cache_dir() == tmp_path / "xdg" / "smolbot"
    monkeypatch.setenv("SMOLBOT_CACHE", str(tmp_path / "mine"))
    assert get_default_cache_dir() == tmp_path / "mine"
