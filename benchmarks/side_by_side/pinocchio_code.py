# SPDX-License-Identifier: Apache-2.0
"""Pinocchio in a native loop: pinocchio_loop.cpp, compiled here against the headers of its wheel.

Pinocchio gives the accelerations; the integration steps are ours. Everything is compiled from the headers
for this machine's processor, as a user who needs speed would do. Loops are closed by constraintDynamics
without gains and with gains tuned by hand, or by lcaba.
"""

import ctypes
import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pinocchio
from scipy.integrate import DOP853

from .measure import Entry, geometric
from .problems import BALL, CYLINDRICAL, FREE, GROUND, HINGE, SLIDE, UNIVERSAL

CODE = "pinocchio"
SOURCE = Path(__file__).with_name("pinocchio_loop.cpp")
BUILD = Path(sys.prefix, "benchmarks")
PREFIX = Path(pinocchio.__file__).parents[4]
FLAGS = [
    "-std=c++17",
    "-O3",
    "-march=native",
    "-DNDEBUG",
    "-w",
    "-shared",
    "-fPIC",
    "-DBOOST_MPL_LIMIT_LIST_SIZE=30",
    "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS",
    f"-I{PREFIX / 'include'}",
    f"-I{PREFIX / 'include' / 'eigen3'}",
]
KINDS = {FREE: 0, BALL: 1, HINGE: 2, SLIDE: 3, UNIVERSAL: 4, CYLINDRICAL: 5}
# How loops are closed: regularisation, whether by lcaba, iterations. For redundant rows the regularisation
# is that of the documentation; balls have no such rows. lcaba always needs one. In 4.1.0 it gives wrong
# motions for S4 and S7, whose trees have balls.
REDUNDANT, REGULAR, EMBEDDED = (1e-12, 0, 10), (0.0, 0, 1), (1e-6, 1, 3)
# Decay rates of the gaps of a loop, 1/s. 100 is the best of 0, 10, 30, 60, 100, 200 and 300 for
# P3; 0 is better for S5 and S7, and for S4 at the target 1e-3.
RATES = (0.0, 100.0)

# The classical Runge-Kutta method; its weights are the last row.
RK4 = [[0, 0, 0, 0], [1 / 2, 0, 0, 0], [0, 1 / 2, 0, 0], [0, 0, 1, 0], [1 / 6, 1 / 3, 1 / 3, 1 / 6]]


def version():
    """Version of the package."""
    return pinocchio.__version__


def _library():
    """Compiled loop, cached by source, compiler and version."""
    compiler = shutil.which(os.environ.get("CXX", "g++"))
    if compiler is None:
        raise ImportError("there is no C++ compiler for its loop (g++, or that in CXX)")
    if not (PREFIX / "include" / "eigen3").is_dir():
        raise ImportError("the headers of Eigen are missing (pip install cmeel-eigen)")
    key = hashlib.sha256(repr((SOURCE.read_text(), FLAGS, version(), compiler)).encode())
    path = BUILD / f"pinocchio_loop_{key.hexdigest()[:12]}.so"
    if not path.exists():
        print("Compiling the loop around Pinocchio (once; one or two minutes)", flush=True)
        BUILD.mkdir(parents=True, exist_ok=True)
        made = path.with_suffix(f".{os.getpid()}")
        run = subprocess.run([compiler, *FLAGS, str(SOURCE), "-o", str(made)], capture_output=True, text=True)
        if run.returncode:
            error = next((line for line in run.stderr.splitlines() if "error" in line), "")
            raise ImportError(f"its loop does not compile: {error[:300]}")
        made.replace(path)
    library = ctypes.CDLL(str(path))
    library.make.restype = ctypes.c_void_p
    library.end_state.restype = ctypes.c_double
    return library


LIBRARY = _library()


def _doubles(values):
    return np.ascontiguousarray(values, dtype=float).ctypes


def _integers(values):
    return np.ascontiguousarray(values, dtype=np.int32).ctypes


def _turn(joint):
    """Orientation (3, 3) of a joint's frame: z along the joint's axis, unless that is an axis of the world.

    Pinocchio has faster code for hinges and slides along the axes of their frames.
    """
    if joint.kind not in (HINGE, SLIDE) or joint.axis.max() == 1.0:
        return np.eye(3)
    turn = np.linalg.qr(np.column_stack([joint.axis, np.eye(3)]))[0][:, ::-1].copy()
    turn[:, 2] = joint.axis
    turn[:, 0] *= np.linalg.det(turn)
    return turn


class _Run:
    """Munthe-Kaas method of a tableau with a number of steps per duration."""

    def __init__(self, problem, tableau, highest, steps, closing=REDUNDANT, rate=RATES[-1]):
        self.steps, self.count = steps, len(problem.bodies)
        self.step = ctypes.c_double(problem.duration / steps)
        bodies, tree = problem.bodies, problem.tree
        kinds = [KINDS[joint.kind] for joint in tree] or [KINDS[FREE]]
        parents = [joint.parent for joint in tree] or [GROUND]
        points = [joint.point for joint in tree] or [bodies[0].position]
        axes = [[*joint.axis, *joint.second] for joint in tree] or [np.zeros(6)]
        turns = [_turn(joint) for joint in tree] or [np.eye(3)]
        origin = {GROUND: np.zeros(3)} | dict(enumerate(points))
        speeds = [rate for i in range(len(tree)) for rate in problem.rates(i)]
        speeds = speeds or [*bodies[0].velocity, *bodies[0].omega]
        anchors = [[*(loop.point - origin[loop.parent]), *(loop.point - origin[loop.child])] for loop in problem.loops]
        self.loop = ctypes.c_void_p(
            LIBRARY.make(
                self.count,
                _integers(kinds),
                _integers(parents),
                _doubles([points[i] - origin[parents[i]] for i in range(self.count)]),
                _doubles(axes),
                _doubles(turns),
                _doubles([body.mass for body in bodies]),
                _doubles([body.position - points[i] for i, body in enumerate(bodies)]),
                _doubles([body.inertia for body in bodies]),
                _doubles(problem.gravity),
                _doubles(speeds),
                len(anchors),
                _integers([[loop.parent, loop.child] for loop in problem.loops]),
                _doubles(anchors),
                len(tableau) - 1,
                _doubles(tableau),
                highest,
                ctypes.c_double(closing[0]),
                ctypes.c_double(rate),
                *closing[1:],
            )
        )

    def __del__(self):
        LIBRARY.destroy(self.loop)

    def reset(self):
        LIBRARY.reset(self.loop)

    def take(self, steps):
        LIBRARY.advance(self.loop, self.step, ctypes.c_long(steps))

    def advance(self, times):
        self.take(times * self.steps)

    def end(self):
        rotations = np.zeros((self.count, 3, 3))
        gap = LIBRARY.end_state(self.loop, _doubles(rotations))
        return rotations, gap

    def steps_per_duration(self):
        return self.steps


def entries(problem, ratio):
    """Methods of order 4 and, outside of the ranking, of order 8."""
    levels = geometric(problem.coarsest, ratio)
    eight = np.vstack([DOP853.A, DOP853.B])
    for words, closing, rate in _closings(problem):
        for name, tableau, highest in (("RK4", RK4, 2), ("our RK8", eight, 6)):
            yield Entry(
                CODE,
                " ".join(filter(None, (name, problem.joints, words))),
                levels,
                lambda steps, t=tableau, p=highest, c=closing, r=rate: _Run(problem, t, p, steps, c, r),
                counted=tableau is RK4,
            )


def _closings(problem):
    """[(description, how, rate)] of the options to close loops."""
    if not problem.loops:
        return [("", REDUNDANT, 0.0)]
    regular = all(loop.kind == BALL for loop in problem.loops) and not problem.redundant
    closing = REGULAR if regular else REDUNDANT
    ways = [("gains" if rate else "no gains", closing, rate) for rate in RATES]
    return [*ways, ("lcaba", EMBEDDED, 0.0)]


def stepper(problem, step):
    """Function take_steps(n) of RK4 steps, to measure the cost of a step."""
    # For redundant rows of balls constraintDynamics gives NaN with any regularisation.
    closing = EMBEDDED if problem.redundant else REDUNDANT
    run = _Run(problem, RK4, 2, round(problem.duration / step), closing)
    return run.take
