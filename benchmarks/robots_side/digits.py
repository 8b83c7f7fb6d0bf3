# SPDX-License-Identifier: Apache-2.0
"""Accelerations of a robot with 50 digits, to decide which of two codes is wrong.

Uses the dense equations of test/precise.py. Some links of robots are point masses, so M is singular. Adding
J^T J makes it regular without changing the solution.
"""

import sys
from pathlib import Path

import numpy as np

from liegroup_core.lie.groups import SO3

sys.path.append(str(Path(__file__).resolve().parents[2] / "test"))

import precise  # noqa: E402
from jets import decimals  # noqa: E402
from precise import NearlySingular  # noqa: E402, F401


def against_digits(scene, pose, twist, *found):
    """Largest errors of accelerations `found` (n, 6), relative to the largest acceleration.

    pose (n, 12), twist (n, 6) : of the body frames
    Raises NearlySingular.
    """
    bodies = [
        body.remade(
            ("rotation_vector", "axis", "angle"),
            position=C[9:],
            quaternion=SO3.to_quaternion(C[:9].reshape(3, 3)),
            angular_velocity=V[:3],
            linear_velocity=V[3:],
        )
        for body, C, V in zip(scene.bodies, pose, twist)
    ]
    exact = _solved(scene.remade(bodies=bodies)).reshape(-1, 6)
    largest = np.abs(exact.astype(float)).max()
    return [float(np.abs((decimals(each) - exact).astype(float)).max() / largest) for each in found]


@precise.precise
def _solved(scene):
    """(6 n,) accelerations in decimals."""
    system = precise._system(scene, (), precise.Reader())
    keep = precise._independent_rows(system.J)
    J, wanted, n = system.J[keep], system.right[keep], len(system.Q)
    K = decimals(np.zeros((n + len(J), n + len(J))))
    K[:n, :n] = J.T @ J
    for i, block in enumerate(system.masses):
        K[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] += block
    K[n:, :n], K[:n, n:] = J, J.T
    right = np.concatenate([system.Q + J.T @ wanted, wanted])
    left, x = K.copy(), right.copy()
    for k in range(len(K)):
        below = k + 1 + np.flatnonzero(left[k + 1 :, k])
        across = k + 1 + np.flatnonzero(left[k, k + 1 :])
        factor = left[below, k] / left[k, k]
        left[np.ix_(below, across)] -= np.outer(factor, left[k, across])
        x[below] -= factor * x[k]
    for k in reversed(range(len(K))):
        across = k + 1 + np.flatnonzero(left[k, k + 1 :])
        if len(across):
            x[k] -= left[k, across] @ x[across]
        x[k] /= left[k, k]
    error = abs(K @ x - right).astype(float)
    assert (error <= 1e-25 * (abs(K) @ abs(x) + abs(right)).astype(float).max()).all()
    return x[:n]
