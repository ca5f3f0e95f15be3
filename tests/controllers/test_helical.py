"""The helical controller on its own model of the world: it alternates, bends, notices what it lost, and gives up."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from controllers.helical import Helical
from smolbot.core.pose import Pose
from smolbot.core.rotations import matrix_from_quaternion, quaternion_from_axes
from smolbot.core.shots import Listen, MoveMagnet, Rotate, Shot
from smolbot.errors import InputError
from smolbot.flight.pilots import Follower
from smolbot.motion import helix_kernels as kernels
from smolbot.motion.controller import Command
from smolbot.paths.curve import Curve
from smolbot.paths.visits import find_visits
from tests.conftest import mission_of

KNOWN = np.diag([5e-5] * 3 + [5e-3] * 3) ** 2


def mission():
    return mission_of("s_path", cycle__half_periods="4")  # quicker to check


@cache
def setup():
    return mission().helix_setup()


def pose_of(position, heading, trusted=True):
    ahead = np.array([np.cos(heading), np.sin(heading), 0.0])
    orientation = quaternion_from_axes(ahead, np.array([0, 0, 1.0]), "zx")
    return Pose(0.0, np.asarray(position), orientation, KNOWN, trusted=trusted)


class World:
    """Moves as the controller believes, unless told that the robot is stuck above a rate of turn."""

    def __init__(self, path, offset=(0.0, 0.0), fastest=np.inf, wall=np.inf):
        tangent = path.tangent(np.zeros(1))[0]
        heading = np.arctan2(tangent[1], tangent[0])
        start = path.points[0] + np.array([*offset, 0.0]) - 2e-3 * tangent
        self.pose = pose_of([start[0], start[1], setup().helix.high], heading)
        self.fastest, self.wall = fastest, wall
        self.shots = []

    def play(self, windows):
        self.shots.append(Shot(windows))
        fast = max(w.frequency for w in windows if isinstance(w, Rotate)) > self.fastest
        if self.pose.position[0] > self.wall and fast:
            return
        position, orientation, _, _ = setup().helix.carry(windows, self.pose.position, self.pose.orientation)
        self.pose = Pose(0.0, position, orientation, KNOWN)


def fly(path, world, gains=None, cycles=2000):
    controller = Helical(setup(), gains or {})
    controller.reset(path, world.pose)
    said = []
    for _ in range(cycles):
        command = controller.command(world.pose)
        said.append(command)
        if command.done or command.stuck:
            break
        if command.mechanical:
            world.play(command.mechanical)
    return controller, said


def line(length=12e-3, start=-6e-3):
    return Curve(np.array([[start, 0, 0.0495], [start + length, 0, 0.0495]]))


def test_it_reaches_the_end_of_the_s_within_the_path_and_the_stages_limits():
    world = World(mission().path)
    _, said = fly(mission().path, world)
    assert said[-1].done
    assert len(world.shots) >= 8  # the paper's pauses
    for shot in world.shots:
        assert setup().limits.faults(shot) == []
    end = world.pose.position
    assert np.linalg.norm(end[:2] - mission().path.points[-1, :2]) < 1.2e-3


def figure_eight():
    a = np.linspace(0.0, 2.0 * np.pi, 121)
    return np.column_stack([10.0 * np.sin(2.0 * a), 17.0 * np.sin(a)])


def circle_twice():
    a = np.linspace(0.0, 4.0 * np.pi, 241)
    return 8.0 * np.column_stack([np.cos(a), np.sin(a)])


@pytest.mark.parametrize("shape", [figure_eight, circle_twice])
def test_a_path_that_crosses_or_repeats_itself_is_screwed_along_whole_and_in_order(shape):
    flat = 1e-3 * shape()
    path = Curve(np.column_stack([flat, np.full(len(flat), 0.0495)]))
    world = World(path)
    trail = [world.pose.position]
    controller = Helical(setup(), {})
    controller.reset(path, world.pose)
    for _ in range(400):
        command = controller.command(world.pose)
        if command.done or command.stuck:
            break
        if command.mechanical:
            before = world.pose
            world.play(command.mechanical)
            trail += [
                setup().helix.carry(command.mechanical[:i], before.position, before.orientation)[0]
                for i in range(2, len(command.mechanical) + 1)
            ]
    assert command.done
    assert find_visits(path, np.array(trail), 1.2e-3).share > 0.99


def test_a_pose_far_from_everything_ends_nothing():
    controller, world = Helical(setup(), {"listens": 1}), World(line())
    controller.reset(line(), world.pose)
    assert controller.command(world.pose).mechanical
    controller.command(world.pose)
    for far in ([1.0, 1.0, 1.0], [-0.3, 0.0, -0.2]):
        assert not controller.command(pose_of(far, 0.0)).done
        controller.command(pose_of(far, 0.0))


def test_every_maneuver_fetches_the_magnet_and_takes_it_away_and_is_followed_by_a_pause():
    _, said = fly(line(), World(line()), {"listens": 4})
    listened = 0
    for command in said[:-1]:
        if command.mechanical:
            first, *turns, last = command.mechanical
            assert (first, last) == (MoveMagnet("near", 10.0), MoveMagnet("away", 10.0))
            assert all(isinstance(w, Rotate) for w in turns)
            assert listened >= 3 or command is next(c for c in said if c.mechanical)
            listened = 0
        else:
            listened += 1


def test_it_does_not_act_on_poses_that_are_not_trusted():
    controller, world = Helical(setup(), {"listens": 1}), World(line())
    controller.reset(line(), world.pose)
    vague = Pose(0.0, world.pose.position, world.pose.orientation, KNOWN, trusted=False)
    assert all(not controller.command(vague).mechanical for _ in range(20))
    assert controller.command(world.pose).mechanical


def test_it_comes_back_to_the_path_from_beside_it():
    path = line(20e-3, -10e-3)
    world = World(path, offset=(0.0, 1e-3))
    _, said = fly(path, world)
    assert said[-1].done
    assert abs(world.pose.position[1]) < 0.25e-3


def test_a_step_out_is_noticed_from_poses_and_recovered_from_more_slowly():
    world = World(line(), fastest=0.1, wall=-4e-3)
    _, said = fly(line(), world)
    assert said[-1].done
    events = [c.event for c in said if c.event]
    assert events[0] == "step-out"
    assert "recovered" in events
    slow = [c for c in said if c.event == "step-out"]
    for before, after in zip([0.25, 0.125], slow, strict=False):
        back, *ahead = [w for w in after.mechanical if isinstance(w, Rotate)]
        assert back.frequency == pytest.approx(before / 2)
        assert back.axis[0] > 0.9  # the magnet turns the other way: the robot backs off
        assert all(w.axis[0] < -0.5 for w in ahead)


def test_it_gives_up_with_a_reason_after_its_tries_and_never_stalls():
    world = World(line(), fastest=0.0, wall=-4e-3)
    _, said = fly(line(), world, {"tries": 2})
    assert said[-1].stuck
    assert "stepped out 3 times in a row" in said[-1].note
    assert not said[-1].mechanical


def test_what_it_learns_of_the_helix_comes_from_the_way_it_went():
    """A robot that advances 6 % farther than believed, and is steered half as much again."""
    controller, path = Helical(setup(), {}), mission().path
    truth = setup().helix.factors * np.array([1.06, 1.3, 0, 1.0])
    world = World(path)
    controller.reset(path, world.pose)
    state = np.array([*world.pose.position, 0, 0, np.nan])
    ahead = matrix_from_quaternion(world.pose.orientation)[:, 2]
    state[kernels.HEADING] = np.arctan2(ahead[1], ahead[0])
    for _ in range(300):
        command = controller.command(pose_of(state[:3], state[kernels.HEADING]))
        if command.done:
            break
        if command.mechanical:
            state[kernels.COURSE] = np.nan
            for window in command.mechanical[1:-1]:
                course = np.arctan2(-window.axis[1], -window.axis[0])
                state = kernels.advance_screw(
                    setup().helix.body, truth, state, course, 1.0, window.turns, window.frequency
                )
            state[kernels.PITCH] = 0.0  # the poses that it is told are level
    learned = controller.model.factors
    assert learned[0] == pytest.approx(truth[0], rel=0.03)
    assert learned[1] == pytest.approx(truth[1], rel=0.2)


def test_unknown_gains_and_gains_out_of_range_are_refused():
    with pytest.raises(InputError, match="unknown gain of helical"):
        Helical(setup(), {"turns": 2.0})
    with pytest.raises(InputError, match="must lie within"):
        Helical(setup(), {"tries": 99.0})


def test_a_maneuver_that_was_held_back_is_offered_again():
    class Asked:
        count = 0

        def reset(self, path, pose):
            pass

        def command(self, pose):
            self.count += 1
            return Command((MoveMagnet("near", 1.0), MoveMagnet("away", 1.0)))

    class Believed:
        pose, confirmed, misses, learned = pose_of([0, 0, 0.05], 0.0), True, 0, False

        def pose_at(self, time):
            return self.pose

    asked = Asked()
    pilot = Follower(line(), asked)
    hold = Shot((Listen(2, 181.0),))
    first = pilot.command(hold, Believed())
    assert pilot.command(hold, Believed()) is first
    assert asked.count == 1
    pilot.command(Shot(first.mechanical), Believed())
    assert asked.count == 2


@pytest.mark.parametrize("aside_deg", [-60.0, -30.0, 45.0])
@pytest.mark.parametrize("short_mm", [1.0, 1.5, 2.0, 2.1, 2.2, 3.0])
def test_backing_off_and_going_on_again_keeps_the_axis_to_its_stages_rate(short_mm, aside_deg):
    whole = mission().path
    path = Curve(whole.at(np.linspace(whole.length - 7e-3, whole.length, 60)))
    place, ahead = path.at(path.length - short_mm * 1e-3), path.tangent(np.array([path.length - short_mm * 1e-3]))[0]
    place = place + 0.4e-3 * np.array([-ahead[1], ahead[0], 0.0])
    stuck = pose_of([*place[:2], setup().helix.high], np.arctan2(ahead[1], ahead[0]) + np.radians(aside_deg))
    controller = Helical(setup(), {"listens": 1})
    controller.reset(path, World(path).pose)
    events = []
    for _ in range(8):  # it never moves
        command = controller.command(stuck)
        events.append(command.event)
        if command.mechanical:
            assert setup().limits.faults(Shot(command.mechanical)) == []
    assert "step-out" in events
