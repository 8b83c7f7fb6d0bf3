# SPDX-License-Identifier: Apache-2.0
"""This package on the problems: each method of order 4 or more, on each group.

It runs without an error estimate, as the other codes do; `estimating` adds the estimate to measure its cost.
"""

import logging
import math

import numpy as np

from liegroup_core import Scene, Simulation, SimulationError, load_scene
from liegroup_core.engine import Engine
from liegroup_core.lie.groups import SO3
from liegroup_core.methods.table import CONFIGURATION_GROUPS, METHODS
from liegroup_core.scene.description import Body, Frame, Joint
from liegroup_core.settings import SETTINGS

from .measure import Entry, geometric
from .problems import BALL, CYLINDRICAL, FREE, GROUND, HINGE, SLIDE, UNIVERSAL

CODE = "liegroup_core"
# Methods of lower order are not competitive for any target.
LOWEST_ORDER = 4
JOINT_TYPES = {
    BALL: "spherical",
    HINGE: "revolute",
    SLIDE: "prismatic",
    UNIVERSAL: "universal",
    CYLINDRICAL: "cylindrical",
}
# The option `group`.
GROUPS = ("auto", *CONFIGURATION_GROUPS)
LOOSEST, TIGHTEST = 1e-2, 1e-13


def prepare():
    """Compile the kernels and silence warnings of coarse steps."""
    Engine(load_scene("heavy_top"))
    logging.getLogger("liegroup_core").setLevel(logging.ERROR)


def scene_of(problem):
    """Scene of the problem: joint frames at the joint points, their z along the axes of joints."""

    def name(body):
        return "world" if body == GROUND else f"body{body}"

    bodies = [
        Body(
            name=name(i),
            mass=body.mass,
            position=body.position,
            inertia=body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]],
            angular_velocity=body.omega,
            linear_velocity=body.velocity,
        )
        for i, body in enumerate(problem.bodies)
    ]
    joints = [
        Joint(
            name=f"joint{i}",
            type=JOINT_TYPES[joint.kind],
            parent=name(joint.parent),
            child=name(joint.child),
            child_frame=_frame(joint, joint.point - problem.bodies[joint.child].position),
        )
        for i, joint in enumerate(problem.tree + problem.loops)
        if joint.kind != FREE
    ]
    return Scene(name="problem", gravity=problem.gravity, bodies=bodies, joints=joints)


def _frame(joint, position):
    """Frame of a joint on its child; that of a universal joint has x and y along its two axes."""
    if joint.kind == UNIVERSAL:
        turned = np.column_stack([joint.axis, joint.second, np.cross(joint.axis, joint.second)])
        return Frame(position=position, rotation_vector=SO3.log(turned))
    return Frame(position=position, axis=joint.axis if joint.axis.any() else None)


def _has_error_control(method):
    return METHODS[method].controlled


class _Run:
    """A number of steps per duration, or substeps chosen by a tolerance."""

    def __init__(self, problem, scene, method, level, make=Engine, **options):
        self.controlled = _has_error_control(method)
        self.steps = 1 if self.controlled else level
        if self.controlled:
            options = options | {"rtol": level, "atol": level}
        # Without the step check, because the other codes have none.
        self.simulation = make(scene, method=method, step=problem.duration / self.steps, **options)
        self.start = self.simulation.state()
        # Restart for each duration: later substeps would belong to another kind of motion. With loops,
        # the constraint violations of coarse steps grow, and correcting them would cost extra.
        self.anew = bool(problem.loops) or self.controlled and problem.changes

    def reset(self):
        self.simulation.set_state(*self.start)

    def advance(self, times):
        try:
            if not self.anew:
                self.simulation.advance(times * self.steps)
                return
            for _ in range(times):
                self.reset()
                self.simulation.advance(self.steps)
        except SimulationError as error:
            raise ArithmeticError(str(error)) from None

    def end(self):
        sample = self.simulation.sample()
        return sample.pose_matrices[:, :3, :3], sample.constraint_residual

    def steps_per_duration(self):
        return self.simulation.substeps[1] if self.controlled else self.steps


def _levels(problem, method, ratio):
    """Step counts, or tolerances that increase the number of substeps by the same ratio."""
    if not _has_error_control(method):
        return geometric(problem.coarsest, ratio)
    count = math.ceil(math.log(LOOSEST / TIGHTEST, ratio) / METHODS[method].order)
    return [LOOSEST / ratio ** (METHODS[method].order * k) for k in range(count + 1)]


def entries(problem, ratio, groups=GROUPS[:1]):
    """All methods and groups; for loops also all stabilisations."""
    scene = scene_of(problem)
    for stabilisation in SETTINGS["stabilisation"].choices if problem.loops else ("none",):
        for group in groups:
            for method in METHODS:
                # Others conserve momentum over long runs, or are for single bodies or stiff scenes.
                if METHODS[method].order >= LOWEST_ORDER and METHODS[method].family == "rkmk":
                    options = {"group": group, "stabilisation": stabilisation}
                    yield _entry(problem, scene, method, ratio, options)


def _entry(problem, scene, method, ratio, options):
    words = [method, options["group"].replace("auto", ""), problem.joints, options["stabilisation"].replace("none", "")]
    setting = " ".join(filter(None, words))
    levels = _levels(problem, method, ratio)

    def start(level, **more):
        return _Run(problem, scene, method, level, **options, **more)

    return Entry(CODE, setting, levels, start, kind=options["group"])


def estimating(entry):
    """Copy of one of our entries, with the running estimate of the error."""
    return Entry(
        CODE,
        f"{entry.setting} + estimate",
        entry.levels,
        lambda level: entry.start(level, make=Simulation),
        counted=False,
    )


def stepper(problem, step, group=GROUPS[0]):
    """Function take_steps(n) of RKMK4 steps from the initial state, restarted after each duration."""
    simulation = Engine(scene_of(problem), method="rkmk4", step=step, group=group)
    most = round(problem.duration / step)

    def take_steps(count):
        for done in range(0, count, most):
            simulation.reset()
            simulation.advance(min(most, count - done))

    return take_steps
