"""
Rotations as unit quaternions x y z w in the rows of (N, 4) arrays, as in ROS.

Every function is vectorised and broadcasts over rows; a single (4,) quaternion serves as well.
"""

import math

import numpy as np

IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])


def lengths(vectors: np.ndarray) -> np.ndarray:
    """Return the (N,) lengths of (N, D) vectors; for few columns faster than np.linalg.norm."""
    return np.sqrt(np.einsum('...j,...j->...', vectors, vectors))


def normalize(q: np.ndarray) -> np.ndarray:
    """Return the quaternions at unit length; a zero one becomes NaN."""
    with np.errstate(invalid='ignore', divide='ignore'):
        return np.asarray(q / np.linalg.norm(q, axis=-1, keepdims=True))


def conjugate(q: np.ndarray) -> np.ndarray:
    """Return the inverse rotations of unit quaternions."""
    return q * np.array([-1.0, -1.0, -1.0, 1.0])


def multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the Hamilton products a ⊗ b: first the rotation b, then a."""
    ax, ay, az, aw = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bx, by, bz, bw = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    product = np.empty(np.broadcast_shapes(a.shape, b.shape))
    product[..., 0] = aw * bx + ax * bw + ay * bz - az * by
    product[..., 1] = aw * by - ax * bz + ay * bw + az * bx
    product[..., 2] = aw * bz + ax * by - ay * bx + az * bw
    product[..., 3] = aw * bw - ax * bx - ay * by - az * bz
    return product


def rotate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the (N, 3) vectors ``v`` rotated by ``q``."""
    x, y, z, w = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    vx, vy, vz = v[..., 0], v[..., 1], v[..., 2]
    # v + 2 w (u × v) + 2 u × (u × v), with u the vector part
    tx, ty, tz = 2 * (y * vz - z * vy), 2 * (z * vx - x * vz), 2 * (x * vy - y * vx)
    rotated = np.empty((*np.broadcast_shapes(q.shape[:-1], v.shape[:-1]), 3))
    rotated[..., 0] = vx + w * tx + y * tz - z * ty
    rotated[..., 1] = vy + w * ty + z * tx - x * tz
    rotated[..., 2] = vz + w * tz + x * ty - y * tx
    return rotated


def angle_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """
    Return the angles [rad] in [0, π] of the rotations that take ``b`` to ``a``.

    Unlike the arccos of a trace or of a product it is exact for the smallest angles: the chord
    |a - b| between unit quaternions is 2 sin(θ/4), and |a + b| is 2 cos(θ/4).
    """
    difference, total = lengths(a - b), lengths(a + b)
    # q and -q are the same rotation: the shorter chord is the one meant
    return np.asarray(4 * np.arctan2(np.minimum(difference, total), np.maximum(difference, total)))


def angle(q: np.ndarray) -> np.ndarray:
    """Return the angles [rad] in [0, π] of rotations."""
    return angle_between(q, IDENTITY)


def angle_of_matrix(matrix: np.ndarray) -> float:
    """Return the angle [rad] of a (3, 3) rotation matrix, accurate near 0 and near π."""
    skew = matrix - matrix.T
    sine = math.sqrt(skew[2, 1] ** 2 + skew[0, 2] ** 2 + skew[1, 0] ** 2) / 2
    return math.atan2(sine, (float(np.trace(matrix)) - 1) / 2)


def slerp(a: np.ndarray, b: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """
    Return the rotations at ``weight`` of the way from ``a`` to ``b``, on the shorter arc.

    :param weight: (N,) in [0, 1].
    """
    b = np.where(np.sum(a * b, axis=-1, keepdims=True) < 0, -b, b)
    half = angle_between(a, b)[..., None] / 2
    weight = np.asarray(weight)[..., None]
    # sinc keeps the ratio of sines finite where both poses are the same
    scale = np.sinc(half / np.pi)
    return normalize(
        a * ((1 - weight) * np.sinc((1 - weight) * half / np.pi) / scale)
        + b * (weight * np.sinc(weight * half / np.pi) / scale)
    )


def about_z(angles: np.ndarray) -> np.ndarray:
    """Return the (N, 4) rotations about the z axis by angles [rad]."""
    zero = np.zeros_like(angles)
    return from_rotation_vector(np.stack([zero, zero, angles], axis=-1))


def from_rotation_vector(v: np.ndarray) -> np.ndarray:
    """Return the quaternions of (N, 3) rotation vectors (axis times angle [rad])."""
    angle = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.concatenate([v * (np.sinc(angle / (2 * np.pi)) / 2), np.cos(angle / 2)], axis=-1)


def to_rotation_vector(q: np.ndarray) -> np.ndarray:
    """Return the (N, 3) rotation vectors (axis times angle [rad] in [0, π])."""
    q = np.where(q[..., 3:] < 0, -q, q)
    half = np.arctan2(np.linalg.norm(q[..., :3], axis=-1, keepdims=True), q[..., 3:])
    return np.asarray(q[..., :3] * (2 / np.sinc(half / np.pi)))


def to_matrix(q: np.ndarray) -> np.ndarray:
    """Return the (N, 3, 3) rotation matrices."""
    return np.stack([rotate(q, axis) for axis in np.eye(3)], axis=-1)


def from_matrix(matrix: np.ndarray) -> np.ndarray:
    """
    Return the quaternions of (N, 3, 3) rotation matrices.

    Each row of the symmetric matrix below is a multiple of the quaternion; the longest is the
    best conditioned (after Shepperd 1978).
    """
    m = np.asarray(matrix)
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    x, y, z = (
        m[..., 2, 1] - m[..., 1, 2],
        m[..., 0, 2] - m[..., 2, 0],
        m[..., 1, 0] - m[..., 0, 1],
    )
    xy, xz, yz = (
        m[..., 0, 1] + m[..., 1, 0],
        m[..., 0, 2] + m[..., 2, 0],
        m[..., 1, 2] + m[..., 2, 1],
    )
    rows = np.stack(
        [
            np.stack([1 + xx - yy - zz, xy, xz, x], -1),
            np.stack([xy, 1 - xx + yy - zz, yz, y], -1),
            np.stack([xz, yz, 1 - xx - yy + zz, z], -1),
            np.stack([x, y, z, 1 + xx + yy + zz], -1),
        ],
        -2,
    )
    longest = np.argmax(np.stack([xx - yy - zz, yy - xx - zz, zz - xx - yy, xx + yy + zz], -1), -1)
    return normalize(np.take_along_axis(rows, longest[..., None, None], -2)[..., 0, :])
