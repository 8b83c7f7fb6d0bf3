# SPDX-License-Identifier: Apache-2.0
"""Mutation test: wrong formulas in the sources, and the test that fails for each of them.

    python .ci/mutants.py [WORD ...]       all mutants, or those whose name contains one of the words

A mutant is one change of a formula in a copy of the sources: a sign, a factor or a frame. Its tests
run on the copy, as plain Python, until one fails. Prints a Markdown table. Exit code 1 if a mutant
survives, or if a test fails on the unchanged sources.
"""
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]

DYNAMICS = ("core/test_dynamics.py",)
JOINTS = ("core/test_joints.py",)
GROUPS = ("contract/test_motion_groups.py",)
LIE = ("contract/test_lie_groups.py",)
FORCES = ("contract/test_forces.py", "-k",
          "cancel or gradient or work_is or dissipates or turned or told")
PROJECTION = ("core/test_projection.py", "-k",
              "closes_all or consistent or errors_die and se3-net")
CENTRES = ("core/test_centres.py", "-k", "not symmetry and not whole_motions")
METHODS = ("contract/test_methods.py", "-k", "tableau or conditions or estimate")
MOTION = ("verification/test_reference_kinds.py", "-k", "joint and spherical and ground")
PLANE = ("core/test_planar.py", "-k", "motion_is_that_in_space and x")


class Mutant(NamedTuple):
    """One wrong formula. `right` occurs exactly once in the file."""

    name: str
    file: str           # in liegroup_core/
    right: str
    wrong: str
    tests: tuple        # arguments of pytest


INSIDE = ("core/test_states_inside.py", "-k", "polynomial")

MUTANTS = [
    Mutant("interpolant, derivative at the end", "methods/munthe_kaas/ahead.py",
           "2.0 * end - unit[0] - unit[stages]", "2.0 * end - unit[0] + unit[stages]", INSIDE),
    Mutant("collocation polynomial, powers", "methods/munthe_kaas/collocation.py",
           "np.arange(1, STAGES + 1)", "np.arange(STAGES)", INSIDE),
    Mutant("gyroscopic torque, sign", "dynamics/space.py",
           "return add3(cross3(w, angular)", "return add3(cross3(angular, w)", DYNAMICS),
    Mutant("gyroscopic force, sign", "dynamics/space.py",
           "cross3(v, linear)), cross3(w, linear)", "cross3(v, linear)), cross3(linear, w)", DYNAMICS),
    Mutant("gyroscopic force, missing", "dynamics/space.py",
           "cross3(v, linear)), cross3(w, linear)", "cross3(v, linear)), ZERO3", DYNAMICS),
    Mutant("gravity, in world axes", "forces/gravity.py",
           "tmatvec3(load9(pose, i, 0), load3(model.gravity, 0, 0))",
           "load3(model.gravity, 0, 0)", FORCES),
    Mutant("bias, sign of the bracket", "dynamics/space.py",
           "se3_ad(V[0], V[1], W[0], W[1])", "se3_ad(W[0], W[1], V[0], V[1])", DYNAMICS),
    Mutant("bias, sign of the rows' rate", "dynamics/rows.py",
           "= -rate - product(", "= rate - product(", DYNAMICS),
    Mutant("bias, sign of the error's turn", "dynamics/space.py",
           "cross3(turn, e[1])", "cross3(e[1], turn)", JOINTS),
    Mutant("bias of an open ball joint, turn of the child only", "dynamics/space.py",
           "turn = add3(V[0], W[0])", "turn = V[0]", JOINTS),
    Mutant("J_a, sign of a column", "dynamics/space.py",
           "alpha)), (-back[0],", "alpha)), (back[0],", DYNAMICS),
    Mutant("J_a, sign of the lever", "dynamics/space.py",
           "cross3(p, beta)", "cross3(beta, p)", DYNAMICS),
    Mutant("J_a, frame", "dynamics/space.py",
           "back = tmatvec3(rot, beta)", "back = beta", DYNAMICS),
    Mutant("Baumgarte, sign", "dynamics/loops.py",
           "work.bias[r] -= rate * (", "work.bias[r] += rate * (", PROJECTION),
    Mutant("Baumgarte, half the damping", "dynamics/loops.py",
           "2.0 * work.slip", "1.0 * work.slip", PROJECTION),
    Mutant("projection of positions, sign", "dynamics/loops.py",
           "else work.gap[", "else -work.gap[", PROJECTION),
    Mutant("projection of velocities, sign", "dynamics/loops.py",
           "work.slip[r] if satisfied", "-work.slip[r] if satisfied", PROJECTION),
    Mutant("universal joint, sign of the rate", "joints/perpendicular.py",
           "dot3(x, w) * dot3(y, w) - dot3(w, w)", "dot3(x, w) * dot3(y, w) + dot3(w, w)",
           JOINTS),
    Mutant("rod, no change of direction", "joints/distance.py",
           "udot = scale3(inverse,", "udot = scale3(0.0 * inverse,", DYNAMICS),
    Mutant("screw, sign of the pitch", "joints/pairs.py",
           '_COORDINATES.index("wz")] = -pitch', '_COORDINATES.index("wz")] = pitch', JOINTS),
    Mutant("exp, sign of the sine in an entry", "lie/so3.py",
           "c * x * y - s * z", "c * x * y + s * z", LIE),
    Mutant("dexpinv on SO(3), sign", "lie/so3.py",
           "w[0] - first * a[0]", "w[0] + first * a[0]", LIE),
    Mutant("dexpinv on SE(3), sign", "lie/se3.py",
           "v[0] - first * g[0]", "v[0] + first * g[0]", LIE),
    Mutant("dexpinv on SE(3), sign of the pitch term", "lie/se3.py",
           "q = dot3(xi, eta) * u", "q = -dot3(xi, eta) * u", LIE),
    Mutant("stage, dexpinv of +Psi", "motion_groups/ball.py",
           "psi = (-slopes[at, 0], -slopes[at + 1, 0], -slopes[at + 2, 0])",
           "psi = (slopes[at, 0], slopes[at + 1, 0], slopes[at + 2, 0])", MOTION),
    Mutant("plane, gyroscopic force", "dynamics/plane.py",
           "mass * ax - w * py", "mass * ax + w * py", PLANE),
    Mutant("plane, acceleration of a hinge", "motion_groups/hinge.py",
           "(S[0] * V[2], -S[0] * V[1])", "(-S[0] * V[2], S[0] * V[1])", PLANE),
    Mutant("plane, inertia handed on", "motion_groups/hinge.py",
           "(c * hx - s * hy) - inverse", "(c * hx + s * hy) - inverse", PLANE),
    Mutant("plane, inertia of a slide", "motion_groups/slide.py",
           "wy - a * xy", "wy + a * xy", GROUPS),
    Mutant("plane, row of the parent", "dynamics/plane.py",
           "((px * y - py * x) - alpha", "((py * x - px * y) - alpha", PLANE),
    Mutant("plane, bias", "dynamics/plane.py", "(w * W[1] - wa * V[1])", "(w * W[1] + wa * V[1])",
           PLANE),
    Mutant("plane, response handed on", "dynamics/rows.py", "axpy3(-share, u, se2_wrench",
           "axpy3(share, u, se2_wrench", PLANE),
    Mutant("plane, dexpinv of -Psi", "motion_groups/plane.py", "gx, gy = ey * w - xi * vy, xi * vx - ex * w",
           "gx, gy = xi * vy - ey * w, ex * w - xi * vx", PLANE),
    Mutant("step, increment on the wrong side", "motion_groups/ball.py",
           "matmul3(load9(coordinates, row, 0), so3_exp(xi))",
           "matmul3(so3_exp(xi), load9(coordinates, row, 0))", MOTION),
    Mutant("RKMK4, weights", "methods/table.py",
           "[1 / 6, 1 / 3, 1 / 3, 1 / 6]", "[1 / 6, 1 / 3, 1 / 6, 1 / 3]", METHODS),
    Mutant("spring, stiffness as damping", "forces/spring_damper.py",
           'factor += row["damping"] * (dot3', 'factor += row["stiffness"] * (dot3', FORCES),
    Mutant("spring, sign of the rest length", "forces/spring_damper.py",
           'factor -= row["stiffness"] * row["rest_length"] / length\n            if',
           'factor += row["stiffness"] * row["rest_length"] / length\n            if', FORCES),
    Mutant("damper, sign", "forces/joint_law.py", "(velocity - axis.rate", "(velocity + axis.rate", FORCES),
    Mutant("axis, both bodies pushed alike", "forces/axis.py",
           "_add(row, -effort, unit[1]", "_add(row, effort, unit[1]", FORCES),
    Mutant("axis, parent pushed at its own origin", "forces/axis.py",
           "(cross3(_place(row, pose), on_parent), on_parent)",
           "(cross3(vector3(row[\"parent_origin\"]), on_parent), on_parent)", FORCES),
    Mutant("axis, lever of the child", "forces/axis.py",
           'cross3(vector3(row["child_origin"]), on_child)', "ZERO3", FORCES),
    Mutant("force at a joint, share of its neighbour", "forces/joint_law.py",
           "out[e] = _effort(rows[e]", "out[e] = _effort(rows[0]",
           ("core/test_joint_forces.py", "-k", "law")),
    Mutant("transmitted wrench without commands", "observables/sample.py",
           'found[joint][2 if units[joint] == "rad" else 5] += effort',
           'found[joint][2 if units[joint] == "rad" else 5] += 0.0 * effort',
           ("core/test_joint_forces.py", "-k", "transmits")),
    Mutant("force-torque sensor, lever of its frame", "sensors/force_torque.py",
           "to[:3, 3:] = SO3.hat(p) @ R",
           "to[:3, 3:] = -SO3.hat(p) @ R",
           ("core/test_sensors.py", "-k", "own_frame")),
    Mutant("states that are set, axes of a carried twist", "scene/carried.py",
           "V_rel = SE3.Ad(F_b) @ V_rel",
           "V_rel = 1.0 * V_rel",
           ("core/test_place.py", "-k", "take_their_values or set_together")),
    Mutant("states that are set, turns of a gear", "scene/rearrange.py",
           "{j: unwrapped[j] - principal[j] for j in others}", "{j: 0.0 for j in others}",
           ("core/test_place.py", "-k", "gears")),
    Mutant("cam, bias of its row", "dynamics/coupled_rows.py",
           "return bend * speed * speed", "return -bend * speed * speed",
           ("core/test_couplings.py", "-k", "order_of and rkmk4")),
    Mutant("cam, position residual", "dynamics/couplings.py",
           "a[1] + q * (a[2] + q * a[3])))", "a[1] + q * (a[2] - q * a[3])))",
           ("core/test_couplings.py", "-k", "classical and cam")),
    Mutant("states that are set, rate of a screw", "scene/carried.py",
           'direction[5] = getattr(joint, "pitch", 0.0)',
           "direction[5] = 0.0",
           ("core/test_place.py", "-k", "take_their_values")),
    Mutant("sensor of SDF, side of the joint", "robots/sdf_sensors.py",
           'if direction == "child_to_parent" else {}',
           'if direction == "parent_to_child" else {}',
           ("core/test_robot_sensors.py", "-k", "its_sign")),
    Mutant("motor, no-load speed", "forces/joint_law.py",
           "abs(self.torque) / (self.rate_limit", "abs(self.torque) * (self.rate_limit",
           ("core/test_joint_forces.py", "-k", "law")),
    Mutant("servo, target of the scene only", "forces/joint_law.py",
           "position, velocity = targets[row[\"target\"], 0]", "position, velocity = row[\"position\"]",
           ("core/test_joint_forces.py", "-k", "law")),
    Mutant("servo, limit of one sign only", "forces/joint_law.py",
           'max(effort, -row["limit"])', "effort",
           ("core/test_servos.py", "-k", "at_its_limit and relative")),
    Mutant("effort of a joint, both bodies pushed alike", "forces/joint_effort.py",
           "(joint.parent, parent_frame, -1.0)", "(joint.parent, parent_frame, 1.0)",
           ("core/test_joint_efforts.py", "-k", "internal and rkmk4-relative")),
    Mutant("effort of a slide, moment about the centre of mass only", "forces/joint_effort.py",
           "frame[:3, 3] + com[index[body]]", "frame[:3, 3]",
           ("core/test_joint_efforts.py", "-k", "internal and rkmk4-relative")),
    Mutant("drag, quadratic part without the speed", "forces/drag.py",
           'row["linear"] + row["quadratic"] * math.sqrt(dot3(v, v))',
           'row["linear"] + row["quadratic"]',
           ("verification/test_reference_kinds.py", "-k", "closed_forms and drag")),
    Mutant("applied wrench, other axes", "forces/applied_wrench.py",
           "axes=self.axes", 'axes="body"', FORCES),
    Mutant("applied wrench, sign of the moment", "forces/external.py",
           "torque + _moment(np.array(point), force)", "torque - _moment(np.array(point), force)",
           MOTION[:1] + ("-k", "kind_of_force and applied")),
    Mutant("force at a point in world axes, sign of the moment", "forces/external.py",
           "levers[6] - levers[2], levers[1] - levers[3]))\n    return",
           "levers[2] - levers[6], levers[1] - levers[3]))\n    return",
           ("core/test_wrenches.py", "-k", "whatever_its_point")),
    Mutant("force at a point in world axes, does not turn", "forces/external.py",
           "levers = matmul3(load9(external, i, 16), rot)", "levers = load9(external, i, 16)",
           ("core/test_wrenches.py", "-k", "whatever_its_point")),
    Mutant("peak rate of a motion, factor", "joints/motion.py",
           "np.arange(1.0, 6.0) * np.asarray(motion[2:]", "np.ones(5) * np.asarray(motion[2:]",
           ("core/test_command_limits.py", "-k", "peak_rate")),
    Mutant("velocity at the frame's origin, sign", "scene/centres.py",
           "by(v, (self._crossed @", "by(v, -(self._crossed @", CENTRES),
    Mutant("wrench from outside, sign of the moment", "scene/centres.py",
           "wrench[:3] -= np.cross", "wrench[:3] += np.cross", CENTRES),
    Mutant("velocity at the centre of mass, sign", "scene/centres.py",
           "linear_velocity=v + np.cross(w, com)", "linear_velocity=v - np.cross(w, com)",
           CENTRES),
]


def first_failure(folder, tests):
    """Name of the first test that fails in a copy of the sources, or None."""
    run = subprocess.run(
        [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider",
         "--import-mode=importlib", "-o", "pythonpath=test", f"test/{tests[0]}", *tests[1:]],
        cwd=folder, capture_output=True, text=True,
        # VERIFY: all cases, as `make test` would leave some of those that are selected to other commits.
        env={**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(folder), "VERIFY": "1"})
    if run.returncode == 0:
        return None
    found = re.search(r"^(?:FAILED|ERROR) \S*?(\w+\.py(?:::\S+)?)", run.stdout, re.MULTILINE)
    return found.group(1) if found else f"pytest: exit code {run.returncode}"


def copy_of_sources(folder):
    for name in ("liegroup_core", "liegroup_sim_ros", "test", "config", "docs"):
        shutil.copytree(ROOT / name, folder / name,
                        ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "setup.cfg", folder)


def main(words):
    chosen = [m for m in MUTANTS if not words or any(word in m.name for word in words)]
    wrong = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        copy_of_sources(folder)
        for tests in dict.fromkeys(mutant.tests for mutant in chosen):
            failed = first_failure(folder, tests)
            if failed:
                print(f"without a mutant: {failed} fails")
                wrong += 1
        print("| wrong formula | where | caught by |\n|---|---|---|", flush=True)
        for mutant in chosen:
            path = folder / "liegroup_core" / mutant.file
            text = path.read_text()
            if text.count(mutant.right) != 1:
                caught = f"NOT MADE: {text.count(mutant.right)} places have the text"
                wrong += 1
            else:
                path.write_text(text.replace(mutant.right, mutant.wrong))
                caught = first_failure(folder, mutant.tests) or "NOTHING"
                wrong += caught == "NOTHING"
                path.write_text(text)
            print(f"| {mutant.name} | {mutant.file} | {caught} |", flush=True)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
