"""Between the nodes: accuracy against the coils themselves, and the laws that hold for every table."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scipy.interpolate import NdBSpline
from threadpoolctl import threadpool_limits

from lookup_tables import FieldTable, OutsideTableError, TableError, build, mesh_axis
from lookup_tables.potential import fit_potential


def true_gradient(coil, points, step=2e-4):
    """Fourth-order differences of the coil's own field, (n, 3, 3)."""
    b = coil.field
    return np.stack(
        [
            (8 * (b(points + s) - b(points - s)) - b(points + 2 * s) + b(points - 2 * s)) / (12 * step)
            for s in step * np.eye(3)
        ],
        axis=-1,
    )


def errors(table, coils, points):
    """Largest relative errors of field and gradient over all coils and points."""
    field, gradient = table.field_and_gradient(points)
    worst = np.zeros(2)
    for c, coil in enumerate(coils):
        b, g = coil.field(points), true_gradient(coil, points)
        of_field = np.linalg.norm(field[c] - b, axis=1) / np.linalg.norm(b, axis=1)
        of_gradient = np.linalg.norm(gradient[c] - g, axis=(1, 2)) / np.linalg.norm(g, axis=(1, 2))
        worst = np.maximum(worst, [of_field.max(), of_gradient.max()])
    return worst


def test_field_and_gradient_are_those_of_the_coils_between_the_nodes(table, coils, points):
    of_field, of_gradient = errors(table, coils, points)
    assert of_field < 1e-7
    assert of_gradient < 1e-5


@pytest.mark.parametrize("planes", [2, 3, 4, 5, 6])
def test_few_planes_suffice_for_a_thin_table(coils, axes, planes):
    z = np.linspace(-0.5e-3, 0.5e-3, planes)
    table = build(coils[:2], axes[0], axes[1], z)
    inside = np.random.default_rng(3).uniform(*table.bounds, (50, 3))
    of_field, of_gradient = errors(table, coils[:2], inside)
    assert of_field < 1e-3
    assert of_gradient < 4e-2 / 8 ** (planes - 2) + 1e-5


@pytest.mark.parametrize("normal", [0, 1, 2])
def test_one_plane_of_samples_gives_the_whole_gradient_on_it(coils, axes, normal):
    axes = list(axes[:2])
    axes.insert(normal, np.array([0.001]))
    table = build(coils, *axes)
    inside = np.random.default_rng(4).uniform(*table.bounds, (50, 3))
    of_field, of_gradient = errors(table, coils, inside)
    assert of_field < 1e-6
    assert of_gradient < 1e-4
    away = inside + 0.1 * np.eye(3)[normal]  # no dependence across the plane
    assert table.contains(away).all()
    np.testing.assert_array_equal(table.field(away), table.field(inside))


def test_the_gradient_is_symmetric_and_nearly_free_of_trace(table, points):
    gradient = table.gradient(points)
    np.testing.assert_array_equal(gradient, np.swapaxes(gradient, 2, 3))
    assert np.abs(np.trace(gradient, axis1=2, axis2=3)).max() < 1e-5 * np.abs(gradient).max()


def test_the_gradient_is_the_derivative_of_the_field(table, points):
    inside = points * 0.9
    for j in range(3):
        step = 1e-6 * np.eye(3)[j]
        slope = (table.field(inside + step) - table.field(inside - step)) / 2e-6
        np.testing.assert_allclose(table.gradient(inside)[..., j], slope, atol=1e-6 * np.abs(slope).max())


def test_no_noise_makes_the_field_curl(coils, table, points):
    rng = np.random.default_rng(5)
    noise = 1e-3 * np.abs(table.samples).max() * rng.normal(size=table.samples.shape)
    noisy = FieldTable(table.x, table.y, table.z, table.samples + noise, table.names)
    gradient = noisy.gradient(points)
    np.testing.assert_array_equal(gradient, np.swapaxes(gradient, 2, 3))
    error = noisy.field(points) - table.field(points)
    assert error.std() < noise.std()
    assert (noisy.residual > 1e-4).all()


def test_the_kernel_is_the_spline_that_scipy_evaluates(table, points):
    coefficients, origin, spacing = table.spline
    knots = tuple(origin[i] + spacing[i] * (np.arange(coefficients.shape[i] + 6) - 5) for i in range(3))
    spline = NdBSpline(knots, coefficients, 5)
    for i in range(3):
        nu = np.eye(3, dtype=int)[i]
        np.testing.assert_allclose(table.field(points)[..., i], -spline(points, nu=nu).T, rtol=1e-6, atol=1e-14)
        for j in range(3):
            slope = -spline(points, nu=nu + np.eye(3, dtype=int)[j]).T
            np.testing.assert_allclose(table.gradient(points)[..., i, j], slope, rtol=1e-6, atol=1e-10)


def test_corners_belong_to_the_table_and_points_beyond_do_not(table):
    low, high = table.bounds
    corners = np.array([low, high])
    assert table.contains(corners).all()
    np.testing.assert_allclose(table.field(corners)[:, 0], table.samples[:, 0, 0, 0], rtol=1e-6)
    beyond = np.array([[0, 0, 0], [0.0315, 0, 0], [0, np.nan, 0]])
    assert table.contains(beyond).tolist() == [True, False, False]
    with pytest.raises(OutsideTableError, match=r"\(31.5, 0, 0\) mm .* x -8 to 12, y -10 to 10, z -3 to 3 mm"):
        table.field(beyond)
    with pytest.raises(OutsideTableError, match="nan"):
        table.gradient(beyond[2:])


def test_one_point_without_its_axis_is_explained(table):
    with pytest.raises(TableError, match=r"shape \(n, 3\); got \(3,\). For one point, pass positions\[None, :\]."):
        table.field(np.zeros(3))
    assert table.field(np.zeros((0, 3))).shape == (4, 0, 3)


@pytest.mark.parametrize("fault", ["swapped", "unit", "sign"])
def test_samples_that_no_free_space_can_have_are_refused(table, fault):
    samples = table.samples.copy()
    if fault == "swapped":
        samples = samples[..., [1, 0, 2]]
    elif fault == "unit":
        samples[..., 0] *= 1e3
    else:
        samples[..., 1] *= -1
    with pytest.raises(TableError, match="not a magnetic field in free space"):
        FieldTable(table.x, table.y, table.z, samples, table.names)


def test_shapes_and_meshes_that_do_not_fit_are_refused(table):
    x, y, z, b, names = table.x, table.y, table.z, table.samples, table.names
    with pytest.raises(TableError, match=r"field must have shape .* here \(4, 21, 21, 7, 3\); got \(3, 21, 21, 7, 3\)"):
        FieldTable(x, y, z, b[:3], names)
    with pytest.raises(TableError, match="Axis y must ascend in equal steps"):
        FieldTable(x, y[::-1], z, b, names)
    with pytest.raises(TableError, match="names must differ"):
        FieldTable(x, y, z, b, ["a", "a", "b", "c"])
    with pytest.raises(TableError, match="At most one axis"):
        FieldTable(x[:1], y[:1], z, b[:, :1, :1], names)
    broken = b.copy()
    broken[2, 1, 2, 3, 1] = np.nan
    with pytest.raises(TableError, match=r"By of coil '\+y' is not at node \(1, 2, 3\)"):
        FieldTable(x, y, z, broken, names)


def test_mesh_axis_includes_both_ends_and_never_steps_too_far():
    axis = mesh_axis(-0.0241, 0.024, 0.0005)
    assert (axis[0], axis[-1]) == (-0.0241, 0.024)
    assert np.diff(axis).max() <= 0.0005
    assert len(mesh_axis(-0.024, 0.024, 0.0005)) == 97
    assert mesh_axis(0.06, 0.06, 0.0005).tolist() == [0.06]


def test_importing_the_package_loads_nothing_heavy():
    code = (
        "import sys, smolbot.ui.cli.table; "
        "import lookup_tables, lookup_tables.cache, lookup_tables.table, lookup_tables.plot; "
        "print([m for m in ('scipy', 'magpylib', 'matplotlib', 'numba') if m in sys.modules]); "
        "print(callable(lookup_tables.build))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split("\n")[:2] == ["[]", "True"]


def test_a_fit_does_not_depend_on_how_many_threads_are_lent():
    rng = np.random.default_rng(3)
    samples = rng.normal(size=(4, 61, 61, 9, 3))
    spacing = np.full(3, 5e-4)
    found = set()
    for threads in (1, 2):
        with threadpool_limits(limits=threads, user_api="blas"):
            found.add(fit_potential(spacing, samples).tobytes())
    assert len(found) == 1
