"""The controller's model of motion against closed forms and an independent integration, and the search built on it."""

from __future__ import annotations

from functools import cache, partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import minimize

from smolbot.config.mission import load_steering_mission
from smolbot.motion import kernels
from smolbot.motion.gradient import advance, pack_robot
from smolbot.motion.kernels import CENTER, DRAG, MAGNET, MOMENT, ROTATIONAL_DRAG, STIFFNESS, STOP
from tests.conftest import setup_of

known = partial(setup_of, "line")
NONE = np.zeros((2, 2))


@cache
def body():
    return pack_robot(known().robot)


def changed(**values):
    other = body().copy()
    for name, value in values.items():
        other[getattr(kernels, name)] = value
    return other


@cache
def rigid():
    return changed(STIFFNESS=np.inf, MAGNET=0.0, CENTER=0.0)


@given(st.floats(-3.0, 3.0), st.floats(1e-3, 8e-3), st.floats(0.01, 0.1))
def test_a_rigid_robot_turns_into_a_uniform_field_as_in_closed_form(off, size, duration):
    """tan(angle / 2) falls as exp(-m B t / drag)."""
    field = size * np.array([np.cos(0.3), np.sin(0.3)])
    x, y, heading, _, _, tail = kernels.simulate_window(rigid(), field, NONE, 0.0, 0.0, 0.3 - off, duration, 20)
    left = 2 * np.arctan(np.tan(off / 2) * np.exp(-rigid()[MOMENT] * size / rigid()[ROTATIONAL_DRAG] * duration))
    assert 0.3 - heading == pytest.approx(left, abs=1e-6)
    assert (x, y, tail) == pytest.approx((0, 0, 0), abs=1e-15)


def test_an_aligned_robot_is_pulled_at_the_speed_of_force_over_drag():
    gradient = np.array([[0.1, 0.0], [0.0, -0.1]])
    x, y, heading, middle, _, _ = kernels.simulate_window(
        rigid(), np.array([5e-3, 0.0]), gradient, 0.0, 0.0, 0.0, 0.05, 25
    )
    assert x == pytest.approx(rigid()[MOMENT] * 0.1 * 0.05 / rigid()[DRAG], rel=1e-9)
    assert middle == pytest.approx(0.5 * x, rel=0.05)
    assert (y, heading) == pytest.approx((0, 0), abs=1e-12)


def test_the_housing_turns_about_its_centre_of_drag():
    body = changed(MAGNET=0.0, STIFFNESS=np.inf)
    x, y, heading, _, _, _ = kernels.simulate_window(body, np.array([0.0, 5e-3]), NONE, 0.0, 0.0, 0.0, 0.1, 50)
    center = np.array([x + body[CENTER] * np.cos(heading), y + body[CENTER] * np.sin(heading)])
    assert heading > 1.0
    assert center == pytest.approx([body[CENTER], 0.0], abs=1e-12)


def test_pull_at_the_tail_is_counted():
    gradient = np.array([[-0.1, 0.0], [0.0, 0.1]])
    x, _, _, _, _, tail = kernels.simulate_window(rigid(), np.array([5e-3, 0.0]), gradient, 0.0, 0.0, 0.0, 0.05, 25)
    assert x < 0.0
    assert tail == pytest.approx(-x, rel=1e-6)


@given(st.floats(-1.5, 1.5), st.floats(1e-7, 1e-5))
def test_the_cantilever_bends_until_its_torque_balances_the_field_s_or_it_stops(off, torque):
    bent = kernels.compute_deflection(off, torque, body()[STIFFNESS], body()[STOP])
    if abs(bent) < body()[STOP]:
        assert body()[STIFFNESS] * bent == pytest.approx(torque * np.sin(off - bent), abs=1e-3 * torque)
    else:
        assert abs(torque * np.sin(off - bent)) >= body()[STIFFNESS] * body()[STOP] * (1 - 1e-3)


@settings(max_examples=25)
@given(st.lists(st.floats(0.5, 8.0), min_size=4, max_size=4), st.floats(-3.1, 3.1), st.floats(-9.0, 9.0))
def test_a_window_agrees_with_an_independent_integration(currents, heading, x_mm):
    """Same physics, written down as an ODE with the field of the table itself, by scipy."""
    robot, duration = known().robot, 0.06
    place = np.array([x_mm * 1e-3, -3e-3, 0.06])

    def slope(_, state):
        x, y, h = state
        bent = 0.0
        for _ in range(60):  # plain bisection would do as well
            b, g = at(np.array([x, y]) + body()[MAGNET] * np.array([np.cos(h + bent), np.sin(h + bent)]))
            size, off = np.linalg.norm(b), np.arctan2(b[1], b[0]) - h
            off = (off + np.pi) % (2 * np.pi) - np.pi
            new = np.clip(robot.moment * size * np.sin(off - bent) / robot.stiffness, -robot.theta_max, robot.theta_max)
            bent += 0.3 * (new - bent)
        m = robot.moment * np.array([np.cos(h + bent), np.sin(h + bent)])
        force = g.T @ m
        ahead = np.array([np.cos(h), np.sin(h)])
        torque = m[0] * b[1] - m[1] * b[0]
        torque += (body()[MAGNET] - body()[CENTER]) * (ahead[0] * force[1] - ahead[1] * force[0])
        spin = torque / robot.rotational_drag
        velocity = force / robot.drag - body()[CENTER] * spin * np.array([-ahead[1], ahead[0]])
        return [*velocity, spin]

    def at(p):
        field, gradient = known().table.field_and_gradient(np.array([[p[0], p[1], 0.06]]))
        return np.array(currents) @ field[:, 0, :2], np.einsum("c,cij->ij", currents, gradient[:, 0, :2, :2])

    b, _ = at(place[:2])
    off = (np.arctan2(b[1], b[0]) - heading + np.pi) % (2 * np.pi) - np.pi
    if np.linalg.norm(b) < 1e-3 or abs(off) > 2.6:  # next to no field, or balanced on its head: a hair decides
        return
    out = solve_ivp(slope, (0, duration), [*place[:2], heading], rtol=1e-6, atol=1e-9)
    field, gradient = known().table.field_and_gradient(place[None])
    step, after = advance(robot, field[:, 0], gradient[:, 0], np.array(currents), heading, duration)
    moved = out.y[:2, -1] - place[:2]
    assert step == pytest.approx(moved, abs=3e-5 + 0.08 * np.linalg.norm(moved))
    assert after == pytest.approx(out.y[2, -1], abs=0.05)


def test_the_nearest_place_on_a_leg_is_the_curve_s():
    path = load_steering_mission("r_small").path
    first, last = 1, len(path.points) - 2  # the bowl, from the stem's top back to the stem
    bowl = type(path)(path.points[first : last + 1])
    points, arc = np.ascontiguousarray(path.points[:, :2]), path.arc
    rng = np.random.default_rng(0)
    for s in rng.uniform(0.5e-3, bowl.length - 0.5e-3, 50):
        place = bowl.at(s) + 2e-4 * rng.normal(size=3)
        found, along, across = kernels.find_nearest(points, arc, first, last, arc[first] + s, place[0], place[1])
        wanted, away = bowl.project(place[None])
        assert found - arc[first] == pytest.approx(wanted[0], abs=1e-12)
        assert np.hypot(along, across) == pytest.approx(away[0], abs=1e-12)


def problem(heading):
    """A plan of one window: 0.2 mm beside a straight path, heading off it."""
    place = np.array([[3e-3, -2e-3, 0.06]])
    field, gradient = known().table.field_and_gradient(place)
    b, g = np.ascontiguousarray(field[:, 0, :2]), np.ascontiguousarray(gradient[:, 0, :2, :2])
    points = np.array([[-5e-3, 0.0], [5e-3, 0.0]])
    route = (points, np.array([0.0, 0.01]), np.zeros(41), 2.5e-4)
    leg = (0, 1, 5e-3, 5e-4, 5e-4, 2e-4)
    weights = np.array([1.0, 0.3, 0.5, 1.0, 0.02, 0.1, 1.5e-3, 0.5])
    state, high = np.array([0.0, 2e-4, heading]), np.full(4, 8.0)
    return b, g, np.zeros(4), high, body(), state, np.zeros(2), 0.05, 0.09, 12, route, leg, weights


def room(total, size):
    """What `_compute_residuals` works in, with a Jacobian of `total` rows."""
    jacobian = np.empty((total, size if total else 0))
    return jacobian, np.empty((6, size)), np.empty((7, size)), np.empty(2), np.empty((2, 2))


@pytest.mark.parametrize("windows", [1, 2])
@pytest.mark.parametrize("heading", [0.0, 0.4, -1.0, 2.0])
def test_jacobian_of_a_plan_matches_finite_differences(heading, windows):
    b, g, _, *rest_of = problem(heading)
    currents = np.random.default_rng(3).uniform(0.5, 7.5, (windows, 4))
    size, total = currents.size, 8 * windows + currents.size
    out, ends, full, rough = np.empty(total), np.empty((windows, 3)), room(total, size), room(0, size)
    kernels._compute_residuals(currents, b, g, *rest_of, out, ends, full)
    for i in range(size):
        sides = []
        for nudge in (1e-5, -1e-5):
            other = currents.copy()
            other.flat[i] += nudge
            kernels._compute_residuals(other, b, g, *rest_of, out, ends, rough)
            sides.append(out.copy())
        assert full[0][:, i] == pytest.approx((sides[0] - sides[1]) / 2e-5, abs=1e-4)


@pytest.mark.parametrize("heading", [0.0, 0.4, -1.0, 2.0])
@pytest.mark.parametrize("scale", [0.03, 1.0])
def test_the_cost_of_a_plan_is_the_formula_of_the_law(heading, scale):
    """J of `controllers.predictive.Predictive`, term by term, along a straight path; with little current, of a weak
    field too."""
    b, g, _, *rest_of = problem(heading)
    i_max, body, (x, y, psi), _, _, duration, steps, _, (_, _, s, stride, *_), weights = rest_of
    n, f, h, p, q, c, b_least, knee = weights
    currents = scale * np.random.default_rng(4).uniform(0.5, 7.5, (2, 4))
    wanted = 0.0
    for i in currents:
        field, gradient = i @ b, np.einsum("k,kij->ij", i, g)
        at_magnet = field + gradient @ [x + body[MAGNET] * np.cos(psi), y + body[MAGNET] * np.sin(psi)]
        x, y, psi, _, half_way, tail = kernels.simulate_window(body, field, gradient, x, y, psi, duration, steps)
        s += stride
        off = abs(kernels.wrap_angle(psi))
        wanted += n**2 * ((1e3 * half_way) ** 2 / 4 + (1e3 * y) ** 2)
        wanted += f**2 * (1e3 * (s - (x + 5e-3))) ** 2
        wanted += h**2 * (off**2 if off < knee else knee * (2 * off - knee))
        wanted += p**2 * (1e3 * tail) ** 2
        wanted += c**2 * max(0.0, 1.0 - np.linalg.norm(at_magnet) / b_least) ** 2
        wanted += q**2 * np.sum((i / i_max) ** 2)
    found = kernels._compute_residuals(currents, b, g, *rest_of, np.empty(24), np.empty((2, 3)), room(0, 8))
    assert found == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize("heading", [0.0, 0.4, -1.0, 2.0])
def test_a_plan_is_nearly_as_good_as_any_that_scipy_finds(heading):
    b, g, _, high, body, state, drift, rest, duration, steps, route, leg, weights = given = problem(heading)
    corners = np.array(np.meshgrid(*[[0.0, 8.0]] * 4)).reshape(4, -1).T
    found, currents, _ = kernels.plan_currents(*given, np.ascontiguousarray(corners[:, None, :]), 2, 6)
    assert np.all((currents >= 0.0) & (currents <= 8.0))
    out, ends, full = np.empty(12), np.empty((1, 3)), room(12, 4)
    rest_of = (high, body, state, drift, rest, duration, steps, route, leg, weights, out, ends, full)

    def cost(i):
        """And its slope, by the Jacobian that matches finite differences."""
        value = kernels._compute_residuals(np.clip(i, 0, 8)[None, :], b, g, *rest_of)
        return value, 2.0 * full[0].T @ out

    rng = np.random.default_rng(0)
    begins = [rng.uniform(0, 8, 4) for _ in range(40)]
    best = min(minimize(cost, i, jac=True, method="L-BFGS-B", bounds=[(0, 8)] * 4).fun for i in begins)
    assert cost(currents[0])[0] == pytest.approx(found)
    assert found < 1.1 * best
