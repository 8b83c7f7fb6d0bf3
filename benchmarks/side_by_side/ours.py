# SPDX-License-Identifier: Apache-2.0
"""This package on the problems: each method of order 4 or more, on each group."""
import logging

from liegroup_core import Scene, Simulation, SimulationError, load_scene, simulation
from liegroup_core.integrators.methods import GROUPS, METHODS
from liegroup_core.scene.description import Body, Frame, Joint

from .measure import Entry
from .problems import BALL, GROUND, HINGE

CODE = "liegroup_core"
# Methods of lower order are no candidates for any target.
LOWEST_ORDER = 4
JOINT_TYPES = {BALL: "spherical", HINGE: "revolute"}
STABILISATIONS = getattr(simulation, "STABILISATIONS", ("none",))


def prepare():
    """Compile what has to be, and from then on say nothing of steps that are too coarse."""
    Simulation(load_scene("heavy_top"))
    logging.getLogger("liegroup_core").setLevel(logging.ERROR)


def scene_of(problem):
    """The problem as a scene: joint frames at the joints' points, hinges turning about their z."""
    def name(body):
        return "world" if body == GROUND else f"body{body}"

    bodies = [Body(name=name(i), mass=body.mass, position=body.position,
                   inertia=body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]],
                   angular_velocity=body.omega, linear_velocity=body.velocity)
              for i, body in enumerate(problem.bodies)]
    joints = [Joint(name=f"joint{i}", type=JOINT_TYPES[joint.kind], parent=name(joint.parent),
                    child=name(joint.child),
                    child_frame=Frame(position=joint.point - problem.bodies[joint.child].position,
                                      axis=joint.axis))
              for i, joint in enumerate(problem.tree + problem.loops)]
    return Scene(name="problem", gravity=problem.gravity, bodies=bodies, joints=joints)


def _has_error_control(method):
    tableau = getattr(METHODS[method], "tableau", METHODS[method])
    return getattr(tableau, "e", None) is not None


class _Run:
    """So many steps per duration, or substeps within it as a tolerance asks for them."""

    def __init__(self, problem, scene, method, level, **options):
        self.controlled = _has_error_control(method)
        self.steps = 1 if self.controlled else level
        if self.controlled:
            options |= {"rtol": level, "atol": level}
        self.simulation = Simulation(scene, method=method, step=problem.duration / self.steps,
                                     **options)

    def reset(self):
        self.simulation.reset()

    def advance(self, times):
        try:
            self.simulation.advance(times * self.steps)
        except SimulationError as error:
            raise ArithmeticError(str(error)) from None

    def end(self):
        sample = self.simulation.sample()
        return sample.pose_matrices[:, :3, :3], sample.constraint_residual

    def steps_per_duration(self):
        return self.simulation.substeps[1] if self.controlled else self.steps


def entries(problem, levels):
    """Every method and group; with loops, every stabilisation."""
    scene = scene_of(problem)
    for stabilisation in STABILISATIONS if problem.loops else ("none",):
        for group in GROUPS:
            for method in METHODS:
                if METHODS[method].order < LOWEST_ORDER:
                    continue
                options, words = {"group": group}, [method, group, problem.joints]
                if stabilisation != "none":
                    options["stabilisation"] = stabilisation
                    words.append(stabilisation)
                tolerances = [10.0 ** (-k / 2) for k in range(4, 27)]
                yield Entry(CODE, " ".join(words).strip(),
                            tolerances if _has_error_control(method) else levels,
                            lambda level, m=method, o=options: _Run(problem, scene, m, level, **o))


def stepper(problem, step):
    """Function that takes so many RKMK4 steps of a size from the start."""
    simulation = Simulation(scene_of(problem), method="rkmk4", step=step)

    def take_steps(count):
        simulation.reset()
        simulation.advance(count)
    return take_steps
