# SPDX-License-Identifier: Apache-2.0
"""Kernels of SO(3) and SE(3): properties beyond the group contract.

The contract test reaches exp, log, dexp, dexpinv, Ad, ad and the inverse through the matrix
classes; here are the remaining kernels, the quaternions, the edges, and plain Python.
"""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from liegroup_core.compiling import compiled
from liegroup_core.lie import SE3, SO3, se3, so3

UNIT = 2.0**-53
ROOT = Path(__file__).parents[2]


def vector(rng, size=1.0):
    return tuple((size * rng.standard_normal(3)).tolist())


def pose(rng):
    return se3.se3_exp(vector(rng), vector(rng))


def matrix(R, r):
    C = np.eye(4)
    C[:3, :3] = np.reshape(R, (3, 3))
    C[:3, 3] = r
    return C


@pytest.mark.parametrize("seed", range(5))
def test_compose_and_inverse_against_matrices(seed):
    rng = np.random.default_rng(seed)
    A, B = pose(rng), pose(rng)
    # Entries are sums of three or four products of numbers below 8.
    product = matrix(*se3.se3_compose(*A, *B))
    assert np.abs(product - matrix(*A) @ matrix(*B)).max() <= 64 * UNIT
    assert np.abs(matrix(*se3.se3_inverse(*A)) @ matrix(*A) - np.eye(4)).max() <= 64 * UNIT


@pytest.mark.parametrize("seed", range(5))
def test_Ad_inverse_is_Ad_of_the_inverse(seed):
    rng = np.random.default_rng(seed)
    C, w, v = pose(rng), vector(rng), vector(rng)
    got = np.concatenate(se3.se3_Ad_inverse(*C, w, v))
    want = np.linalg.inv(SE3.Ad(matrix(*C))) @ np.concatenate((w, v))
    assert np.abs(got - want).max() <= 200 * UNIT  # cond(Ad) is below 10 for |r| < 3


@pytest.mark.parametrize("seed", range(5))
def test_ad_transpose_is_the_dual_of_ad(seed):
    rng = np.random.default_rng(seed)
    xi, eta, torque, force = (vector(rng) for _ in range(4))
    got = np.concatenate(se3.se3_ad_transpose(xi, eta, torque, force))
    want = SE3.ad(np.concatenate((xi, eta))).T @ np.concatenate((torque, force))
    assert np.abs(got - want).max() <= 64 * UNIT


# Quaternions (x, y, z, w) that take each of the four roots, and neighbours of a half turn.
QUATERNIONS = [
    (0.0, 0.0, 0.0, 1.0),
    (1.0, 0.0, 0.0, 0.0),
    (0.0, 1.0, 0.0, 0.0),
    (0.0, 0.0, 1.0, 0.0),
    (0.1, 0.2, 0.3, 0.9),
    (0.9, 0.2, 0.3, 0.1),
    (0.2, 0.9, -0.3, 0.1),
    (-0.2, 0.3, 0.9, 0.1),
    (0.5, 0.5, 0.5, 0.5),
    (0.5, -0.5, 0.5, 0.5),
    (1e-9, 0.0, 0.0, 1.0),
    (0.6, 0.8, 0.0, 1e-9),
    (1e-300, -2e-300, 0.0, 1.0),
    (0.9, 0.2, 0.3, -0.1),
    (0.1, 0.2, 0.3, -0.9),
]


@pytest.mark.parametrize("q", QUATERNIONS)
def test_quaternion_to_matrix_and_back(q):
    unit = np.array(q) / np.linalg.norm(q)
    R = so3.so3_from_quaternion(q)
    # The same rotation acting on a vector by the quaternion product, v + 2 u x (u x v + w v).
    v, u = np.array([0.3, -1.0, 2.0]), unit[:3]
    turned = v + 2.0 * np.cross(u, np.cross(u, v) + unit[3] * v)
    assert np.abs(np.reshape(R, (3, 3)) @ v - turned).max() <= 32 * UNIT
    back = np.array(so3.so3_to_quaternion(R))
    assert back[3] >= 0.0
    # Which sign comes is open only at w = 0.
    wanted = -unit if unit[3] < 0.0 or unit[3] == 0.0 and back @ unit < 0.0 else unit
    assert np.abs(back - wanted).max() <= 8 * UNIT
    # Small components keep their relative accuracy next to the identity.
    if abs(q[3]) == 1.0:
        assert np.abs(back - wanted)[:3].max() <= 8 * UNIT * np.abs(q[:3]).max()


@pytest.mark.parametrize("factor", [1e-90, 0.5, -3.0, 1e90])
def test_quaternion_norm_does_not_matter(factor):
    q = np.array([0.1, -0.5, 0.3, 0.7])
    assert np.abs(SO3.from_quaternion(factor * q) - SO3.from_quaternion(q)).max() <= 8 * UNIT


def test_quaternion_zero_is_refused_and_gives_nan_in_a_kernel():
    with pytest.raises(ValueError, match="norm of a quaternion"):
        SO3.from_quaternion([0.0, 0.0, 0.0, 0.0])
    assert any(map(math.isnan, so3.so3_from_quaternion((0.0, 0.0, 0.0, 0.0))))


@pytest.mark.parametrize("size", [5e-324, 1e-310, 1e-300, 1e-160, 1e-154])
def test_tiny_rotations_keep_full_relative_accuracy(size):
    xi = (size, -2.0 * size, 3.0 * size)
    # All digits there are: the factor 1/4 in log costs subnormal numbers their last ones.
    back = so3.so3_log(so3.so3_exp(xi))
    assert max(abs(a - b) for a, b in zip(back, xi)) <= (0.0 if size >= 1e-300 else 2 * 5e-324)
    w, v = (1.0, 2.0, 3.0), (-1.0, 0.5, 4.0)
    assert so3.so3_dexp(xi, w) == so3.so3_dexpinv(xi, w) == w
    # A translation with it: what is left of the bracket is below the last digit of v.
    eta = (10.0, 20.0, 30.0)
    assert se3.se3_exp(xi, eta)[1] == eta
    assert se3.se3_dexpinv(xi, (0.0, 0.0, 0.0), w, v) == (w, v)


def test_pure_translation_is_exact():
    zero, eta, w, v = (0.0, 0.0, 0.0), (2.0, -4.0, 8.0), (1.0, 2.0, 3.0), (4.0, 8.0, 16.0)
    assert se3.se3_exp(zero, eta) == ((1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), eta)
    bracket = np.cross(eta, w)  # the series ends here, as ad^2 w = 0
    assert se3.se3_dexp(zero, eta, w, v) == (w, tuple(v + 0.5 * bracket))
    assert se3.se3_dexpinv(zero, eta, w, v) == (w, tuple(v - 0.5 * bracket))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e200])
def test_non_finite_input_gives_non_finite_output_without_raising(bad):
    xi, ok = (0.1, bad, 0.2), (1.0, 2.0, 3.0)
    results = [
        so3.so3_exp(xi),
        so3.so3_dexp(xi, ok),
        so3.so3_dexpinv(xi, ok),
        sum(se3.se3_exp(xi, ok), ()),
        sum(se3.se3_dexp(xi, ok, ok, ok), ()),
        sum(se3.se3_dexpinv(xi, ok, ok, ok), ()),
    ]
    for result in results:
        assert not all(map(math.isfinite, result))
    if abs(bad) != 1e200:
        R = (1.0, bad, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
        assert not all(map(math.isfinite, so3.so3_log(R)))


@pytest.mark.parametrize("k", [1, 2, 3])
def test_full_turns_are_regular_except_for_dexpinv(k):
    xi = (0.0, 2.0 * math.pi * k, 0.0)
    ok = (1.0, 2.0, 3.0)
    # exp(2 pi k) = I; the angle is known to 2^-53 of itself, its square to 2 of that.
    assert np.abs(SO3.exp(xi) - np.eye(3)).max() <= 2.0 * xi[1] * UNIT
    assert all(map(math.isfinite, sum(se3.se3_dexp(xi, ok, ok, ok), ())))
    assert max(map(abs, so3.so3_dexpinv((0.0, xi[1] * (1.0 - 1e-9), 0.0), ok))) > 1e8


SAMPLE = """
import json, sys
import numpy as np
from liegroup_core.lie import se3, so3
rng = np.random.default_rng(11)
bits = []
for size in 10.0 ** rng.uniform(-9.0, 0.8, 200):
    xi = tuple((size * rng.standard_normal(3)).tolist())
    eta, w, v = (tuple(rng.standard_normal(3).tolist()) for _ in range(3))
    R, r = se3.se3_exp(xi, eta)
    numbers = [R, r, *se3.se3_log(R, r), *se3.se3_dexp(xi, eta, w, v),
               *se3.se3_dexpinv(xi, eta, w, v), so3.so3_to_quaternion(R),
               *se3.se3_Ad(R, r, w, v), *se3.se3_Ad_inverse(R, r, w, v)]
    bits.append([float(x).hex() for group in numbers for x in group])
json.dump(bits, sys.stdout)
"""


@pytest.mark.slow
@pytest.mark.skipif(not compiled(), reason="compares machine code with plain Python")
def test_plain_python_and_compiled_kernels_are_bit_identical():
    def run(disable):
        environment = {**os.environ, "NUMBA_DISABLE_JIT": disable, "PYTHONPATH": str(ROOT)}
        done = subprocess.run(
            [sys.executable, "-c", SAMPLE], env=environment, check=True, capture_output=True, text=True, timeout=60
        )
        return json.loads(done.stdout)

    assert run("0") == run("1")
