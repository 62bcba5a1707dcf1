"""Quaternions against matrices, and the interpolations between them."""

import numpy as np
import pytest

from deepfracture.geometry.rotations import (
    continuous_quats,
    cross,
    nlerp,
    quat_between,
    quat_from_matrix,
    quat_multiply,
    quats_from_matrices,
    rotation_matrices,
    rotation_matrix,
    slerp,
)


@pytest.fixture
def quats() -> np.ndarray:
    values = np.random.default_rng(4).normal(size=(50, 4))
    return values / np.linalg.norm(values, axis=1, keepdims=True)


def test_one_and_many_agree_to_the_last_bit(quats: np.ndarray) -> None:
    np.testing.assert_array_equal(rotation_matrices(quats), [rotation_matrix(quat) for quat in quats])


def test_quaternions_and_matrices_lead_back_to_each_other(quats: np.ndarray) -> None:
    matrices = rotation_matrices(quats)
    np.testing.assert_allclose(matrices @ matrices.transpose(0, 2, 1), np.tile(np.eye(3), (50, 1, 1)), atol=1e-14)
    positive = np.where(quats[:, :1] < 0, -quats, quats)
    np.testing.assert_allclose(quats_from_matrices(matrices), positive, atol=1e-14)
    for matrix, quat in zip(matrices, quats, strict=True):
        assert abs(quat_from_matrix(matrix) @ quat) == pytest.approx(1)


def test_the_product_turns_by_the_second_and_then_by_the_first(quats: np.ndarray) -> None:
    for first, second in zip(quats, quats[::-1], strict=True):
        expected = rotation_matrix(first) @ rotation_matrix(second)
        np.testing.assert_allclose(rotation_matrix(quat_multiply(first, second)), expected, atol=1e-14)


@pytest.mark.parametrize("end", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0.6, 0, 0.8)])
def test_the_shortest_rotation_takes_one_vector_to_the_other(end: tuple[float, float, float]) -> None:
    start = np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(rotation_matrix(quat_between(start, np.array(end))) @ start, end, atol=1e-14)


def test_interpolations_begin_and_end_and_meet_in_the_middle(quats: np.ndarray) -> None:
    start, end = continuous_quats(quats[:2])
    for t in (0.0, 0.5, 1.0):
        np.testing.assert_allclose(slerp(start, end, t), nlerp(start[None], end[None], t)[0], atol=1e-14)
    np.testing.assert_allclose(slerp(start, end, 1.0), end, atol=1e-14)
    assert (np.einsum("ni,ni->n", continuous_quats(quats)[1:], continuous_quats(quats)[:-1]) >= 0).all()


def test_the_vector_product_is_that_of_numpy(quats: np.ndarray) -> None:
    np.testing.assert_array_equal(cross(quats[0, 1:], quats[1, 1:]), np.cross(quats[0, 1:], quats[1, 1:]))
