# SPDX-License-Identifier: Apache-2.0
"""SO(3) and SE(3) for NumPy arrays, computed by the kernels of so3.py and se3.py.

Group elements are matrices, (3, 3) and (4, 4). Elements of the algebra are coordinate vectors: a
rotation vector (3,) in rad, or a screw (xi, eta) (6,), angular part first, in rad and m. Operators
on the algebra are (3, 3) and (6, 6) matrices. Quaternions are (x, y, z, w). dexp is right-translated:
d/dt exp(X) exp(X)^-1 = hat(dexp(X) Xdot), so the body-fixed twist is dexp(-X) Xdot.

Every function takes arrays with any leading dimensions. It raises ValueError for a wrong shape, a
non-finite number or a matrix that is not in the group. Accuracy: see the kernels and
test/contract/test_lie_groups.py. A call takes microseconds per element: loops over steps belong in
a kernel that calls the kernels.
"""

import math

import numpy as np

from .se3 import se3_Ad, se3_ad, se3_dexp, se3_dexpinv, se3_exp, se3_inverse, se3_log
from .so3 import so3_dexp, so3_dexpinv, so3_exp, so3_from_quaternion, so3_log, so3_to_quaternion
from .vec3 import cross3, transpose3

# Largest accepted entry of R^T R - I. A rotation in single precision has a few times 6e-8 and is
# accepted; a scaled one is not.
ROTATION_TOLERANCE = 1e-6
# Initial angles are those nearest to this value, in (-pi, pi]: half a turn is pi, not -pi, whatever
# its round-off.
UNKNOWN_TURN = 1e-9

_NEXT, _LAST = [1, 2, 0], [2, 0, 1]
UNIT3 = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
ZERO3 = (0.0, 0.0, 0.0)
UNIT6 = tuple((e, ZERO3) for e in UNIT3) + tuple((ZERO3, e) for e in UNIT3)


def cross(a, b):
    """Vector products (..., 3) of arrays (..., 3), with the bits of np.cross, in a tenth of its time for one."""
    if a.ndim == b.ndim == 1:
        (a0, a1, a2), (b0, b1, b2) = a.tolist(), b.tolist()
        return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])
    return a[..., _NEXT] * b[..., _LAST] - a[..., _LAST] * b[..., _NEXT]


def _checked(value, shape, what):
    """Convert `value` to a finite float64 array (..., *shape), or raise ValueError.

    what : name of the argument for the message
    """
    expected = f"(..., {', '.join(map(str, shape))})"
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{what} must be numbers of shape {expected}") from None
    if array.shape[-len(shape) :] != shape:
        raise ValueError(f"{what} must have shape {expected}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{what} must be finite, got NaN or infinity")
    return array


def _rotation(value, what):
    """Checked rotation matrices, flattened: (..., 9)."""
    R = _checked(value, (3, 3), what)
    defect = np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)).max(initial=0.0)
    if defect > ROTATION_TOLERANCE:
        raise ValueError(f"{what} is not a rotation: R^T R differs from I by {defect:.1e}")
    if (np.linalg.det(R) < 0.0).any():
        raise ValueError(f"{what} is not a rotation but a reflection: det R = -1")
    return R.reshape(R.shape[:-2] + (9,))


def _pose(value, what):
    """Checked pose matrices as flattened rotation (..., 9) and position (..., 3)."""
    C = _checked(value, (4, 4), what)
    if (np.abs(C[..., 3, :] - (0.0, 0.0, 0.0, 1.0)) > ROTATION_TOLERANCE).any():
        raise ValueError(f"{what} is not a pose: its last row must be 0 0 0 1")
    return _rotation(C[..., :3, :3], what), C[..., :3, 3]


def _screw(value, what):
    """Checked 6-vectors as angular (..., 3) and linear part (..., 3)."""
    X = _checked(value, (6,), what)
    return X[..., :3], X[..., 3:]


def _map(function, shape, *arrays):
    """Apply `function`, from tuples to a result of `shape`, to the last dimension of all arrays."""
    leading = arrays[0].shape[:-1]
    rows = (array.reshape(-1, array.shape[-1]).tolist() for array in arrays)
    results = [function(*map(tuple, row)) for row in zip(*rows)]
    return np.array(results, dtype=np.float64).reshape(leading + shape)


def _matrix3(kernel, a):
    """Matrix of the map w -> kernel(a, w): its columns are the images of the axes."""
    return np.transpose([kernel(a, e) for e in UNIT3])


def _matrix6(kernel, a, b):
    """Matrix of the map (w, v) -> kernel(a, b, w, v)."""
    return np.transpose([np.concatenate(kernel(a, b, *e)) for e in UNIT6])


def _matrix4(R, r):
    """Matrix of a pose (R, r), as a flat tuple."""
    return (*R[:3], r[0], *R[3:6], r[1], *R[6:], r[2], 0.0, 0.0, 0.0, 1.0)


def within_a_turn(angle, near=0.0):
    """Angle nearest to `near` that differs from `angle` by whole turns, rad."""
    return angle - 2.0 * math.pi * math.floor((angle - near) / (2.0 * math.pi) + 0.5)


class SO3:
    """Rotation group: rotation vectors xi (3,), rad; rotation matrices R (3, 3)."""

    @staticmethod
    def hat(xi):
        """Antisymmetric matrix of xi: hat(xi) w = xi x w."""
        return _map(lambda x: _matrix3(cross3, x), (3, 3), _checked(xi, (3,), "xi"))

    @staticmethod
    def vee(matrix):
        """Vector of the antisymmetric part of a matrix: the inverse of hat."""
        m = _checked(matrix, (3, 3), "matrix")
        m = 0.5 * (m - np.swapaxes(m, -1, -2))
        return np.stack((m[..., 2, 1], m[..., 0, 2], m[..., 1, 0]), axis=-1)

    @staticmethod
    def exp(xi):
        """Rotation matrix of a rotation vector of any length."""
        return _map(so3_exp, (3, 3), _checked(xi, (3,), "xi"))

    @staticmethod
    def log(R):
        """Rotation vector of a rotation matrix, |xi| <= pi; at pi the sign is undefined."""
        return _map(so3_log, (3,), _rotation(R, "R"))

    @staticmethod
    def inverse(R):
        """Inverse rotation, R^T."""
        return _map(transpose3, (3, 3), _rotation(R, "R"))

    @staticmethod
    def Ad(R):
        """Matrix of the adjoint action, Ad w = vee(R hat(w) R^-1): R itself."""
        return _map(tuple, (3, 3), _rotation(R, "R"))

    @staticmethod
    def ad(xi):
        """Matrix of the Lie bracket with xi: hat(xi) itself."""
        return SO3.hat(xi)

    @staticmethod
    def dexp(xi):
        """Right-translated differential of exp (left Jacobian), Rdot R^T = hat(dexp xidot)."""
        return _map(lambda x: _matrix3(so3_dexp, x), (3, 3), _checked(xi, (3,), "xi"))

    @staticmethod
    def dexpinv(xi):
        """Inverse of dexp, |xi| < 2 pi; grows like 1/(2 pi - |xi|)."""
        return _map(lambda x: _matrix3(so3_dexpinv, x), (3, 3), _checked(xi, (3,), "xi"))

    @staticmethod
    def to_quaternion(R):
        """Unit quaternion (x, y, z, w), w >= 0, of a rotation matrix."""
        return _map(so3_to_quaternion, (4,), _rotation(R, "R"))

    @staticmethod
    def from_quaternion(quaternion):
        """Rotation matrix of a quaternion (x, y, z, w) of any norm in 1e-100 ... 1e100."""
        q = _checked(quaternion, (4,), "quaternion")
        norm = np.linalg.norm(q, axis=-1)
        if ((norm < 1e-100) | (norm > 1e100)).any():
            raise ValueError("the norm of a quaternion must be between 1e-100 and 1e100")
        return _map(so3_from_quaternion, (3, 3), q)


class SE3:
    """Rigid-body motions: screws X = (xi, eta) (6,), rad and m; pose matrices C (4, 4)."""

    @staticmethod
    def hat(X):
        """Matrix [[hat(xi), eta], [0, 0]] of a screw."""
        xi, eta = _screw(X, "X")
        out = np.zeros(xi.shape[:-1] + (4, 4))
        out[..., :3, :3] = SO3.hat(xi)
        out[..., :3, 3] = eta
        return out

    @staticmethod
    def vee(matrix):
        """Screw of a matrix: the inverse of hat."""
        m = _checked(matrix, (4, 4), "matrix")
        return np.concatenate((SO3.vee(m[..., :3, :3]), m[..., :3, 3]), axis=-1)

    @staticmethod
    def exp(X):
        """Pose of a screw, |xi| of any size."""
        return _map(lambda x, e: _matrix4(*se3_exp(x, e)), (4, 4), *_screw(X, "X"))

    @staticmethod
    def log(C):
        """Screw of a pose, |xi| <= pi; at pi the sign of xi is undefined."""
        return _map(lambda R, r: np.concatenate(se3_log(R, r)), (6,), *_pose(C, "C"))

    @staticmethod
    def inverse(C):
        """Inverse pose, C^-1."""
        return _map(lambda R, r: _matrix4(*se3_inverse(R, r)), (4, 4), *_pose(C, "C"))

    @staticmethod
    def Ad(C):
        """Matrix of the adjoint action, Ad V = vee(C hat(V) C^-1): [[R, 0], [hat(r) R, R]]."""
        return _map(lambda R, r: _matrix6(se3_Ad, R, r), (6, 6), *_pose(C, "C"))

    @staticmethod
    def ad(X):
        """Matrix of the Lie bracket with X: [[hat(xi), 0], [hat(eta), hat(xi)]]."""
        return _map(lambda x, e: _matrix6(se3_ad, x, e), (6, 6), *_screw(X, "X"))

    @staticmethod
    def dexp(X):
        """Right-translated differential of exp (left Jacobian), Cdot C^-1 = hat(dexp Xdot)."""
        return _map(lambda x, e: _matrix6(se3_dexp, x, e), (6, 6), *_screw(X, "X"))

    @staticmethod
    def dexpinv(X):
        """Inverse of dexp, |xi| < 2 pi; grows like |eta|/(2 pi - |xi|)^2."""
        return _map(lambda x, e: _matrix6(se3_dexpinv, x, e), (6, 6), *_screw(X, "X"))
