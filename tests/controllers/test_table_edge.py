"""Poses outside the field table: a little outside, the nearest place inside counts; farther, nothing is driven."""

from __future__ import annotations

import numpy as np
import pytest

from controllers.current_ratio import CurrentRatio
from controllers.force_pursuit import ForcePursuit
from controllers.predictive import Predictive
from lookup_tables import OutsideTableError
from smolbot.core.pose import Pose
from smolbot.core.rotations import quaternion_from_axes
from smolbot.core.shots import Actuate, Listen, Shot
from smolbot.flight.pilots import Follower
from smolbot.motion.controller import Command
from smolbot.paths.curve import Curve
from tests.conftest import setup_of

LAWS = [CurrentRatio, ForcePursuit, Predictive]
SETUP = "r_path"


def pose(x, y, z, time=0.0):
    q = quaternion_from_axes(np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]), "zy")
    return Pose(time, np.array([x, y, z]), q, np.diag([2.5e-9] * 3 + [1e-4] * 3))


def path():
    return Curve(np.array([[-4.0, 0.0, 60.0], [4.0, 0.0, 60.0]]) * 1e-3)


def begun(law):
    controller = law(setup_of(SETUP), {})
    controller.reset(path(), pose(-4e-3, 0.0, 0.06))
    controller.command(pose(-4e-3, 0.0, 0.06))
    return controller


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("side", [-1, 1])
def test_far_outside_nothing_is_driven_and_the_note_says_so(law, axis, side):
    controller = begun(law)
    place = np.array([-4e-3, 0.0, 0.06])
    place[axis] = setup_of(SETUP).table.bounds[(side + 1) // 2][axis] + side * 10e-3
    command = controller.command(pose(*place, time=0.2))
    assert command.window is None
    assert "outside the field table" in command.note
    assert not command.done
    assert isinstance(controller.command(pose(-4e-3, 0.0, 0.06, time=0.4)).window, Actuate)  # and on it goes


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_little_outside_it_steers_as_at_the_nearest_place_inside(law, axis):
    edge = np.array([-4e-3, 0.0, 0.06])
    edge[axis] = setup_of(SETUP).table.bounds[1][axis]
    beyond = edge.copy()
    beyond[axis] += 0.5 * setup_of(SETUP).tolerance
    at_edge, outside = (begun(law).command(pose(*place, time=0.2)) for place in (edge, beyond))
    assert outside.window == at_edge.window


class Careless:
    """A law that asks the table at whatever pose it is given."""

    def __init__(self):
        self.table = setup_of(SETUP).table

    def reset(self, path, pose):
        pass

    def command(self, pose):
        self.table.field(pose.position[None])
        return Command(Actuate((0.0, 0.0, 0.0, 1.0), 0.03), progress=1e-3)


class Tracked:
    confirmed, misses, learned = True, 0, False

    def __init__(self, place):
        self.pose = pose(*place)

    def pose_at(self, time):
        return self.pose


def test_a_law_that_asks_beyond_the_table_drives_nothing_until_a_pose_is_inside():
    outside = Tracked((-4e-3, 0.0, 1.0))
    with pytest.raises(OutsideTableError):
        Careless().command(outside.pose)
    pilot, hold = Follower(path(), Careless()), Shot((Listen(2, 103.5),))
    assert pilot.command(hold, outside).window is None
    assert pilot.command(hold, Tracked((-4e-3, 0.0, 0.06))).window is not None
    answer = pilot.command(hold, outside)
    assert answer.window is None
    assert answer.progress == 1e-3
    assert "nothing is driven" in answer.note
    assert "outside the table" in answer.note
