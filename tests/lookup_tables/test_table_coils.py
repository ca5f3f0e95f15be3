"""Coils against closed forms and against magpylib's own evaluation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lookup_tables import FlatCoil, RoundCoil, TableError

MU_0 = 4e-7 * np.pi


def assert_relative(field, reference, tolerance):
    distance = np.linalg.norm(field - reference, axis=1) / np.linalg.norm(reference, axis=1)
    assert distance.max() < tolerance


def test_a_thin_coil_has_the_closed_form_of_a_loop_on_its_axis():
    radius, turns = 0.025, 50
    loop = RoundCoil("loop", (0, 0, 0.01), (0, 0, 2), radius * (1 - 1e-7), radius * (1 + 1e-7), 1e-8, turns)
    z = np.linspace(-0.05, 0.05, 11)
    field = loop.field(np.column_stack([0 * z, 0 * z, z + 0.01]))
    expected = 0.5 * MU_0 * turns * radius**2 / (radius**2 + z**2) ** 1.5
    np.testing.assert_allclose(field[:, 2], expected, rtol=1e-6)
    assert np.abs(field[:, :2]).max() < 1e-12


def test_a_thin_flat_coil_has_the_closed_form_of_a_rectangle_on_its_axis():
    a, b, turns = 0.030, 0.025, 10  # half sides
    coil = FlatCoil("flat", (0, 0, 0), (0, 1, 0), 1e-8, 2 * a, 2 * b, (1, 0, 0), turns)
    y = np.linspace(-0.05, 0.05, 11)
    field = coil.field(np.column_stack([0 * y, y, 0 * y]))
    far = np.sqrt(a**2 + b**2 + y**2)
    expected = MU_0 * turns * a * b / (np.pi * far) * (1 / (a**2 + y**2) + 1 / (b**2 + y**2))
    np.testing.assert_allclose(field[:, 1], expected, rtol=1e-6)


def test_width_lies_along_the_width_direction():
    coil = FlatCoil("flat", (0, 0, 0), (0, 1, 0), 0.01, 0.060, 0.020, (1, 0.3, 0), 10)
    beside = np.abs(coil.field(np.array([[0.028, 0.0, 0.0], [0.0, 0.0, 0.028]]))[:, 1])
    assert coil.width_direction.tolist() == [1, 0, 0]
    assert beside[0] > beside[1]  # inside the wide side, outside the narrow one


def test_the_field_of_a_positive_current_points_toward_the_coil(coils):
    for coil in coils:
        b = coil.field(np.zeros((1, 3)))[0]
        assert b @ coil.center == pytest.approx(np.linalg.norm(b) * np.linalg.norm(coil.center))


def test_field_is_that_of_the_magpylib_source(coils, points):
    for coil in coils:
        direct = coil.source().getB(points)
        assert np.abs(coil.field(points) - direct).max() < 1e-9 * np.abs(direct).max()


def test_a_tilted_coil_turns_its_field(coils, points):
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    coil = coils[0]
    turned = replace(coil, center=turn @ coil.center, axis=turn @ coil.axis)
    np.testing.assert_allclose(turned.field(points @ turn.T), coil.field(points) @ turn.T, atol=1e-12)
    np.testing.assert_allclose(turned.source().getB(points), turned.field(points), atol=1e-12)


def test_few_loops_stand_for_the_whole_winding(coils):
    near = np.array([[0.024, 0.024, 0.003], [0.024, 0.0, 0.0], [0.0, 0.0, 0.0]])
    fine = replace(coils[0], radial_loops=12, axial_loops=12).field(near)
    assert_relative(coils[0].field(near), fine, 1e-6)
    flat = FlatCoil("flat", (0, 0, -0.03), (1, 0, 0), 0.06, 0.05, 0.01, (0, 1, 0), 100, build_up=0.004)
    many = replace(flat, axial_loops=40, build_loops=8).field(near)
    assert_relative(flat.field(near), many, 1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"axis": (0, 0, 0)}, "axis must not be zero"),
        ({"center": (0, 0)}, "center must be three finite numbers"),
        ({"outer_radius": 0.01}, "outer_radius must exceed inner_radius"),
        ({"turns": 0}, "turns must be positive"),
    ],
)
def test_a_coil_that_cannot_exist_is_refused(coils, change, message):
    with pytest.raises(TableError, match=message):
        replace(coils[0], **change)
