"""Rotations obey their group's laws, and agree with scipy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from smolbot.core.pose import Pose
from smolbot.core.rotations import (
    compute_rotation_error,
    matrix_from_quaternion,
    multiply_quaternions,
    quaternion_from_axes,
    quaternion_from_matrix,
    quaternion_from_rotation_vector,
    rotation_vector_from_quaternion,
)
from smolbot.errors import InputError

number = st.floats(-1, 1, allow_subnormal=False)
vectors = st.tuples(number, number, number).map(np.array)
quaternions = (
    st.tuples(number, number, number, number)
    .map(np.array)
    .filter(lambda q: np.linalg.norm(q) > 0.1)
    .map(lambda q: q / np.linalg.norm(q))
)


@given(quaternions)
def test_a_quaternion_turns_vectors_as_scipys_does(q):
    assert matrix_from_quaternion(q) == pytest.approx(Rotation.from_quat(q, scalar_first=True).as_matrix(), abs=1e-12)


@given(quaternions)
def test_matrix_and_quaternion_are_each_others_inverse(q):
    back = quaternion_from_matrix(matrix_from_quaternion(q))
    assert back[0] >= 0
    assert abs(back @ q) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.6, 0.8, 0), (0.5, -0.5, np.sqrt(0.5))])
def test_half_turns_survive_the_way_through_a_matrix(axis):
    q = np.concatenate([[0.0], axis])
    assert abs(quaternion_from_matrix(matrix_from_quaternion(q)) @ q) == pytest.approx(1.0, abs=1e-12)


@given(quaternions, quaternions)
def test_the_product_turns_by_one_and_then_the_other(a, b):
    both = matrix_from_quaternion(multiply_quaternions(a, b))
    assert both == pytest.approx(matrix_from_quaternion(a) @ matrix_from_quaternion(b), abs=1e-12)


@given(vectors)
def test_log_undoes_exp_up_to_half_a_turn(vector):
    assert rotation_vector_from_quaternion(quaternion_from_rotation_vector(3.1 / np.sqrt(3) * vector)) == pytest.approx(
        3.1 / np.sqrt(3) * vector, abs=1e-9
    )


@given(vectors)
def test_exp_agrees_with_scipys_rotation_vector(vector):
    ours = matrix_from_quaternion(quaternion_from_rotation_vector(5 * vector))
    assert ours == pytest.approx(Rotation.from_rotvec(5 * vector).as_matrix(), abs=1e-12)


@pytest.mark.parametrize("size", [0.0, 1e-300, 1e-13, 1e-9])
def test_tiny_turns_keep_their_size_and_direction(size):
    turn = size * np.array([0.6, 0.0, -0.8])
    assert rotation_vector_from_quaternion(quaternion_from_rotation_vector(turn)) == pytest.approx(
        turn, rel=1e-6, abs=0
    )


@given(quaternions, vectors)
def test_the_error_is_the_world_turn_that_takes_truth_to_estimate(truth, error):
    estimate = multiply_quaternions(quaternion_from_rotation_vector(error), truth)
    assert compute_rotation_error(estimate, truth) == pytest.approx(error, abs=1e-9)
    assert compute_rotation_error(-estimate, truth) == pytest.approx(error, abs=1e-9)


@pytest.mark.parametrize("order", ["xy", "yx", "yz", "zy", "zx", "xz"])
def test_axes_point_along_the_given_directions(order):
    first, second = np.array([0.2, -0.9, 0.4]), np.array([1.0, 0.3, 0.3])
    rotation = matrix_from_quaternion(quaternion_from_axes(first, second, order))
    assert rotation[:, "xyz".index(order[0])] == pytest.approx(first / np.linalg.norm(first))
    assert rotation[:, "xyz".index(order[1])] @ second > 0
    assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_a_pose_is_a_unit_quaternion_and_cannot_be_changed():
    pose = Pose(0.0, np.zeros(3), np.array([1.0, 0, 0, 0]), np.eye(6))
    with pytest.raises(ValueError, match="read-only"):
        pose.position[0] = 1.0
    with pytest.raises(InputError, match="unit quaternion"):
        Pose(0.0, np.zeros(3), np.array([1.0, 1, 0, 0]), np.eye(6))
    with pytest.raises(InputError, match=r"position must have shape \(3,\)"):
        Pose(0.0, np.zeros(2), np.array([1.0, 0, 0, 0]), np.eye(6))
    with pytest.raises(InputError, match="finite"):
        Pose(0.0, np.array([0, np.nan, 0]), np.array([1.0, 0, 0, 0]), np.eye(6))
    assert pose.at(3.0).time == 3.0
    assert pose.body_axis("z") == pytest.approx([0, 0, 1])
