"""Rotations as unit quaternions (w, x, y, z) and as matrices.

SciPy's `Rotation` rounds differently (most matrices and products differ in the last bit) and takes 4 to 30 times as
long for a single rotation; it serves where many matrices become quaternions at once."""

from __future__ import annotations

import numpy as np

from deepfracture.types import Floats


def rotation_matrix(quat_wxyz: Floats) -> Floats:
    """Rotation matrix of a unit quaternion, shape (3, 3)."""
    return np.array(_rows(*(float(value) for value in quat_wxyz)))


def rotation_matrices(quats_wxyz: Floats) -> Floats:
    """Rotation matrices of unit quaternions (..., 4), shape (..., 3, 3)."""
    return np.moveaxis(np.array(_rows(*np.moveaxis(quats_wxyz, -1, 0))), (0, 1), (-2, -1))


def _rows(w, x, y, z):
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]


def quat_from_matrix(matrix: Floats) -> Floats:
    """Unit quaternion of a rotation matrix, shape (4,): Shepperd 1978, the largest component first."""
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    squares = (a + e + i, a, e, i)
    k = squares.index(max(squares))
    if k == 0:
        quat = np.array([1 + a + e + i, h - f, c - g, d - b])
    elif k == 1:
        quat = np.array([h - f, 1 + a - e - i, b + d, c + g])
    elif k == 2:
        quat = np.array([c - g, b + d, 1 - a + e - i, f + h])
    else:
        quat = np.array([d - b, c + g, f + h, 1 - a - e + i])
    return quat / np.linalg.norm(quat)


def quats_from_matrices(matrices: Floats) -> Floats:
    """Quaternions (..., 4) with w >= 0 of rotation matrices (..., 3, 3)."""
    from scipy.spatial.transform import Rotation

    quats = np.roll(Rotation.from_matrix(matrices).as_quat(), 1, axis=-1)
    return np.where(quats[..., :1] < 0, -quats, quats)


def quat_between(start: Floats, end: Floats) -> Floats:
    """The shortest rotation from one unit vector to another; opposite ones turn about an axis normal to z or x."""
    axis, cosine = np.cross(start, end), start @ end
    if cosine < -1 + 1e-9:
        axis = np.cross(end, (0.0, 0.0, 1.0) if abs(end[2]) < 0.9 else (1.0, 0.0, 0.0))
        return np.array([0.0, *(axis / np.linalg.norm(axis))])
    quat = np.array([1 + cosine, *axis])
    return quat / np.linalg.norm(quat)


def quat_multiply(first: Floats, second: Floats) -> Floats:
    """Hamilton product, shape (4,): the rotation `second`, then `first`."""
    a, b, c, d = (float(value) for value in first)
    w, x, y, z = (float(value) for value in second)
    return np.array(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ]
    )


def nlerp(start: Floats, end: Floats, t: float) -> Floats:
    """Normalised linear interpolation along the shorter arcs, shape (n, 4)."""
    end = np.where(np.einsum("ni,ni->n", start, end)[:, None] >= 0, end, -end)
    quats = (1 - t) * start + t * end
    return quats / np.linalg.norm(quats, axis=1, keepdims=True)


def slerp(start: Floats, end: Floats, t: float) -> Floats:
    """Spherical linear interpolation (Shoemake 1985) of quaternions in one hemisphere, shape (4,)."""
    angle = np.arccos(np.clip(start @ end, -1.0, 1.0))
    if angle < 1e-6:
        return start
    return (np.sin((1 - t) * angle) * start + np.sin(t * angle) * end) / np.sin(angle)


def continuous_quats(quats_wxyz: Floats) -> Floats:
    """The same rotations, normalised, each quaternion in the hemisphere of its predecessor, shape (n, 4)."""
    quats = quats_wxyz / np.linalg.norm(quats_wxyz, axis=1, keepdims=True)
    turn = np.einsum("ni,ni->n", quats[1:], quats[:-1]) < 0
    flips = np.concatenate([[0], np.cumsum(turn)]) % 2
    return np.where(flips[:, None] == 1, -quats, quats)


def cross(a: Floats, b: Floats) -> Floats:
    """Vector product of two vectors (3,); `np.cross` spends 30 microseconds on its checks."""
    (ax, ay, az), (bx, by, bz) = a, b
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
