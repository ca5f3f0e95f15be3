"""Allocated currents against brute force, scipy and magpylib: where the force points, how strong, at what heat."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from controllers import ForceAllocator, UnreachableForceError
from controllers.allocation import _maximize_force
from lookup_tables import OutsideTableError
from smolbot.errors import InputError
from tests.conftest import mission_of, setup_of

known = partial(setup_of, "line")
MOMENT, MOST, Z = 0.89e-3, 8.0, 0.06


def allocator(**options):
    return ForceAllocator(known().table, MOST, MOMENT, **options)


def place(radius_mm, angle_deg, z=Z):
    a = np.radians(angle_deg)
    return np.array([1e-3 * radius_mm * np.cos(a), 1e-3 * radius_mm * np.sin(a), z])


def unit(angle_deg):
    return np.array([np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg)), 0.0])


def forces(table, position, currents, moment=MOMENT):
    """Field (n, 3) and force (n, 3) of sets of currents (n, n_coils), written down plainly."""
    b, g = table.field(position[None, :])[:, 0], table.gradient(position[None, :])[:, 0]
    field = currents @ b
    slope = np.einsum("nc,cij->nij", currents, g)
    return field, moment * np.einsum("ni,nij->nj", field, slope) / np.linalg.norm(field, axis=1)[:, None]


def angle_off(force, way):
    return np.degrees(np.arccos(np.clip(force[..., :2] @ way[:2] / np.linalg.norm(force[..., :2], axis=-1), -1.0, 1.0)))


def brute_force(table, position, low, high, least, head_first, count=400_000):
    """Forces (n, 2) of random currents, half of them on a bound, that keep to the rules."""
    rng = np.random.default_rng(0)
    n = table.n_coils
    currents = rng.uniform(low, high, (count, n))
    kind = rng.integers(0, 3, (count, n))
    currents = np.where(kind == 0, low, np.where(kind == 1, high, currents))
    currents = currents[np.any(currents != 0.0, axis=1)]
    field, force = forces(table, position, currents)
    level = np.linalg.norm(field[:, :2], axis=1)
    kept = (level >= least) & (np.abs(field[:, 2]) <= 0.3 * level)  # a floating robot follows no steeper field
    if head_first:
        kept &= np.sum(field[:, :2] * force[:, :2], axis=1) >= 0.0
    return force[kept, :2]


def within(force, way, degrees):
    """Largest force among those that point within some degrees of `way`; 0 if there is none."""
    near = angle_off(force, way) < degrees
    return float(np.linalg.norm(force[near], axis=1).max()) if near.any() else 0.0


class Dipoles:
    """Coils of any number and place, far enough to be dipoles: fields and gradients in closed form."""

    def __init__(self, n, seed):
        rng = np.random.default_rng(seed)
        around = np.linspace(0, 2 * np.pi, n, endpoint=False) + rng.uniform(-0.2, 0.2, n)
        self.at = np.stack([0.06 * np.cos(around), 0.06 * np.sin(around), Z + rng.uniform(-3e-3, 3e-3, n)], axis=1)
        self.moments = 2.0 * (np.array([0, 0, Z]) - self.at) / 0.06  # A·m² per A, toward the middle
        self.n_coils = n

    def field_and_gradient(self, points):
        r = points[None, :, :] - self.at[:, None, :]
        m = np.broadcast_to(self.moments[:, None, :], r.shape)
        d = np.linalg.norm(r, axis=2)[..., None]
        along = np.sum(m * r, axis=2)[..., None]
        field = 1e-7 * (3 * r * along / d**5 - m / d**3)
        outer = r[..., :, None] * m[..., None, :]
        gradient = outer + np.swapaxes(outer, 2, 3) + along[..., None] * np.eye(3)
        gradient = 3e-7 * (gradient - 5 * along[..., None] * r[..., :, None] * r[..., None, :] / d[..., None] ** 2)
        return field, gradient / d[..., None] ** 5

    def field(self, points):
        return self.field_and_gradient(points)[0]

    def gradient(self, points):
        return self.field_and_gradient(points)[1]


@settings(max_examples=60)
@given(st.floats(0, 8), st.floats(-180, 180), st.floats(-180, 180), st.floats(59.0, 61.0))
def test_inside_8_mm_every_direction_is_reached_head_first_within_limits(radius, around, toward, height):
    here, way = place(radius, around, 1e-3 * height), unit(toward)
    found = allocator().allocate(here, way)
    field, force = forces(known().table, here, found.currents[None, :])
    assert np.all((found.currents >= 0.0) & (found.currents <= MOST))
    assert angle_off(force[0], way) < 0.2
    assert field[0, :2] @ force[0, :2] >= -1e-12 * np.linalg.norm(force)
    assert np.linalg.norm(force[0, :2]) > 60e-6
    assert found.force == pytest.approx(force[0], rel=1e-9)
    assert found.head_first


@settings(max_examples=60)
@given(st.floats(0, 20), st.floats(-180, 180), st.floats(-180, 180))
def test_out_to_20_mm_every_direction_is_reached_with_30_un_by_either_end(radius, around, toward):
    here, way = place(radius, around), unit(toward)
    found = allocator(head_first=False).allocate(here, way)
    _, force = forces(known().table, here, found.currents[None, :])
    assert np.all((found.currents >= 0.0) & (found.currents <= MOST))
    assert angle_off(force[0], way) < 0.2
    assert np.linalg.norm(force[0, :2]) > 30e-6


@pytest.mark.parametrize("head_first", [True, False])
@pytest.mark.parametrize(("radius", "around"), [(0.0, 0.0), (3.0, 20.0), (8.0, 77.0), (12.0, -140.0), (19.0, 10.0)])
def test_no_currents_pull_much_harder_within_the_same_angle(radius, around, head_first):
    here, own = place(radius, around), allocator(head_first=head_first)
    tried = brute_force(known().table, here, 0.0, MOST, own.least_field, head_first)
    shares = []
    for toward in range(0, 360, 15):
        try:
            found = own.allocate(here, unit(toward))
        except UnreachableForceError:
            assert within(tried, unit(toward), 0.2) == 0.0
            continue
        best = within(tried, unit(toward), max(np.degrees(found.direction_error), 0.2))
        shares.append(np.linalg.norm(found.force[:2]) / max(best, 1e-9))
    assert min(shares) > 0.95
    assert np.median(shares) > 0.99


@pytest.mark.parametrize(
    ("radius", "around", "head_first", "currents"),
    [
        (4.0, 17.0, True, [5.38830, 8.0, 0.0, 0.0]),
        (8.0, 45.0, True, [3.72480, 8.0, 0.0, 0.0]),
        (20.0, 17.0, False, [6.14552, 0.0, 8.0, 0.0]),
    ],
)
def test_where_the_best_field_is_the_last_one_that_fits_it_is_found(radius, around, head_first, currents):
    """Two coils alone, of which these currents were found by hand: beyond their field's direction nothing fits."""
    here = place(radius, around)
    _, force = forces(known().table, here, np.array([currents]))
    toward = np.degrees(np.arctan2(force[0, 1], force[0, 0]))
    found = allocator(head_first=head_first).allocate(here, unit(toward))
    assert np.linalg.norm(found.force[:2]) > 0.998 * np.linalg.norm(force[0, :2])


@pytest.mark.parametrize(
    ("radius", "around", "currents"),
    [(0.0, 0.0, [0.0, 0.04225, 2.43254, 2.41162]), (10.0, 73.0, [0.0, 0.0, 2.76465, 7.19880])],
)
def test_the_coolest_currents_are_found_where_few_fit(radius, around, currents):
    """Currents found by hand; Newton steps without a line search missed the first, and every angle near it."""
    here, currents = place(radius, around), np.array(currents)
    _, force = forces(known().table, here, currents[None, :])
    toward, size = np.degrees(np.arctan2(force[0, 1], force[0, 0])), np.linalg.norm(force[0, :2])
    found = allocator(head_first=False).allocate(here, unit(toward), size)
    assert found.currents @ found.currents < 1.005 * (currents @ currents)


@pytest.mark.parametrize(("n", "unipolar"), [(3, True), (3, False), (4, False), (5, True), (6, False), (8, True)])
def test_any_number_of_coils_with_and_without_reversal(n, unipolar):
    table, here = Dipoles(n, n), place(4.0, 50.0)
    own = ForceAllocator(table, 5.0, MOMENT, unipolar=unipolar, least_field=5e-4)
    tried = brute_force(table, here, 0.0 if unipolar else -5.0, 5.0, 5e-4, True)
    reached = 0
    for toward in range(0, 360, 20):
        best = within(tried, unit(toward), 0.5)
        try:
            found = own.allocate(here, unit(toward))
        except UnreachableForceError:
            assert best < 5e-6
            continue
        reached += 1
        _, force = forces(table, here, found.currents[None, :])
        assert np.all(found.currents <= 5.0)
        assert np.all(found.currents >= (0.0 if unipolar else -5.0))
        assert angle_off(force[0], unit(toward)) < 3.2
        assert np.linalg.norm(force[0, :2]) > 0.9 * best
    assert reached >= 12


@pytest.mark.parametrize(("radius", "around", "toward"), [(0, 0, 30), (6, 40, 200), (7, -90, 90), (10, 130, -60)])
def test_a_wanted_size_is_met_at_the_least_heat(radius, around, toward):
    """Against scipy's SLSQP from many starts, which may find no better."""
    here, way, wanted = place(radius, around), unit(toward), 60e-6
    own = allocator(least_field=1e-3)
    found = own.allocate(here, way, wanted)
    assert found.force[:2] == pytest.approx(wanted * way[:2], abs=3e-3 * wanted)
    assert np.linalg.norm(found.field[:2]) >= 1e-3 * (1 - 1e-6)

    def pull(currents):
        field, force = forces(known().table, here, currents[None, :] + 1e-12)
        return field[0], force[0]

    rules = [
        {"type": "eq", "fun": lambda i: (pull(i)[1][:2] - wanted * way[:2]) * 1e6},
        {"type": "ineq", "fun": lambda i: (np.linalg.norm(pull(i)[0][:2]) - 1e-3) * 1e3},
        {"type": "ineq", "fun": lambda i: (pull(i)[0][:2] @ way[:2]) * 1e3},
    ]
    rng = np.random.default_rng(1)
    heats = []
    for _ in range(25):
        out = minimize(
            lambda i: i @ i, rng.uniform(0, MOST, 4), method="SLSQP", bounds=[(0, MOST)] * 4, constraints=rules
        )
        field, force = pull(out.x)
        if np.allclose(force[:2], wanted * way[:2], atol=1e-2 * wanted) and np.linalg.norm(field[:2]) > 0.999e-3:
            heats.append(out.fun)
    assert heats
    assert found.currents @ found.currents < 1.01 * min(heats)


def test_the_heat_grows_with_the_size_up_to_the_strongest_force():
    here, way, own = place(5.0, 10.0), unit(120.0), allocator(least_field=1e-3)
    strongest = np.linalg.norm(own.allocate(here, way).force[:2])
    heats = [np.sum(own.currents(here, way, share * strongest) ** 2) for share in (0.2, 0.5, 0.8, 0.999)]
    assert heats == sorted(heats)
    assert np.all(own.currents(here, way, 0.0) == 0.0)


def test_force_is_that_of_the_coils_themselves():
    """Against magpylib: finite differences of |B| of round coils, without any table."""
    rng, h = np.random.default_rng(2), 2e-5
    coils = mission_of("line").rig.round_coils()
    for _ in range(5):
        here, way = place(rng.uniform(0, 8), rng.uniform(0, 360), 0.0597), unit(rng.uniform(0, 360))
        currents = allocator(least_field=5e-4).currents(here, way)
        around = np.concatenate([here + h * np.eye(3)[:2], here - h * np.eye(3)[:2]])
        size = np.linalg.norm(sum(i * coil.field(around) for i, coil in zip(currents, coils)), axis=1)
        force = MOMENT * (size[:2] - size[2:]) / (2 * h)
        assert angle_off(force, way) < 0.5


def test_a_force_beyond_reach_is_refused_with_what_is_possible():
    here, way = place(2.0, 0.0), unit(45.0)
    with pytest.raises(
        UnreachableForceError, match=r"900 µN at \(2\.0, 0\.0\) mm toward 45° is out of reach: \d+ µN at most"
    ) as refused:
        allocator().currents(here, way, 900e-6)
    assert refused.value.most == pytest.approx(np.linalg.norm(allocator().allocate(here, way).force[:2]), rel=1e-6)


def test_far_out_the_tail_first_fills_gaps_that_head_first_leaves():
    """At 20 mm between two coils, brute force finds none within a degree of 28 to 62 degrees."""
    here, head, either = place(20.0, 45.0), allocator(tolerance=0.0), allocator(head_first=False)
    assert np.all(either.reach(here, 36).force > 0.0)
    reach = head.reach(here, 120)
    unreachable = reach.force <= 0.0
    ends = np.flatnonzero(np.diff(np.concatenate([[0], unreachable, [0]])))
    gaps = 3.0 * (ends[1::2] - ends[::2])
    assert 30.0 <= gaps.max() <= 42.0
    assert np.all(allocator(tolerance=0.0).reach(place(8.0, 45.0), 120).force > 0.0)
    for angle in reach.angles[unreachable][:2]:
        with pytest.raises(UnreachableForceError, match="head first") as refused:
            head.currents(here, unit(np.degrees(angle)))
        assert refused.value.most == 0.0


def test_reach_is_the_strongest_force_in_every_direction():
    reach = allocator().reach(place(6.0, 30.0), 24)
    for angle, force in zip(reach.angles, reach.force):
        found = allocator().allocate(place(6.0, 30.0), unit(np.degrees(angle)))
        assert force == pytest.approx(np.linalg.norm(found.force[:2]), rel=1e-9)
    assert np.linalg.norm(reach.polygon, axis=1) == pytest.approx(reach.force)


@settings(max_examples=20)
@given(st.floats(0, 8), st.floats(-180, 180), st.floats(-180, 180))
def test_what_is_turned_by_a_quarter_is_answered_by_the_next_coils(radius, around, toward):
    """The bench has fourfold symmetry: +x, +y, -x, -y follow each other."""
    own = allocator(least_field=1e-3)
    one = own.allocate(place(radius, around), unit(toward))
    other = own.allocate(place(radius, around + 90.0), unit(toward + 90.0))
    assert np.linalg.norm(other.force) == pytest.approx(np.linalg.norm(one.force), rel=2e-3)


@pytest.mark.parametrize(
    ("direction", "force", "fault"),
    [([0, 0, 1], None, "horizontal"), ([0, 0, 0], None, "horizontal"), ([1, 0, 0], -1e-6, "must not be below 0")],
)
def test_what_cannot_be_meant_is_refused(direction, force, fault):
    with pytest.raises(InputError, match=fault):
        allocator().currents(place(0, 0), np.array(direction, dtype=float), force)


def test_a_place_beyond_the_table_is_refused():
    with pytest.raises(OutsideTableError):
        allocator().currents(place(40.0, 0.0), unit(0))


@pytest.mark.parametrize("fault", [{"max_current": 0.0}, {"moment": -1.0}, {"least_field": 0.0}])
def test_limits_must_make_sense(fault):
    given = {"max_current": 8.0, "moment": 1e-3, "least_field": 1e-4} | fault
    with pytest.raises(InputError, match="above 0"):
        ForceAllocator(known().table, **given)


@pytest.mark.parametrize("n_coils", [1, 2])
def test_fewer_coils_than_equations_have_no_solution_and_nothing_outside_the_arrays_is_written(n_coils):
    equations, untouched = 3, 7.0
    memory = np.full(8, untouched)
    currents = memory[:n_coils]
    found = _maximize_force(
        np.ones((4, n_coils)), np.zeros(4), np.array([0, 2, 3, 1]), equations, np.zeros(n_coils), np.ones(n_coils),
        np.empty(4, np.int64), np.empty((4, 4)), np.empty(4), np.empty(4), currents,
    )  # fmt: skip
    assert not found
    np.testing.assert_array_equal(memory[n_coils:], untouched)
