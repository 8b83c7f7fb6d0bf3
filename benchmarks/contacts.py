# SPDX-License-Identifier: Apache-2.0
"""Contacts compared with Drake's continuous plant: CPU time against error, and the estimate of the error.

    python benchmarks/contacts.py [--json FILE]

    ball     it skids on a plane and then rolls
    box      on four spheres it is thrown on a plane, tumbles and comes to rest

Stiffness 1e5 N/m, dissipation 1 s/m, friction 0.5: the same normal force as Drake's point contact, which is that of
Hunt and Crossley. Its friction is regularised, ours yields by a length, so each is compared with itself at the tightest
accuracy: Drake with steps of 5 us. Drake (`pip install drake`) is omitted if it is not installed.
"""

import argparse
import importlib.util
import json
import time

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from liegroup_core import Simulation
from liegroup_core.scene.load import scene_from_text

SECONDS, ROUNDS = 2.0, 3
CORNERS = [(x, y, -0.05) for x in (0.2, -0.2) for y in (0.15, -0.15)]
TURN, SPIN, SPEED = Rotation.from_euler("ZYX", [0.1, 0.2, 0.3]), (1.0, 2.0, 0.5), (0.5, 0.3, 0.0)
SOLID = [2.0 / 12.0 * (a * a + b * b) for a, b in ((0.3, 0.1), (0.4, 0.1), (0.4, 0.3))]
KEYS = "type: contact, body: b, stiffness: 1e5, damping: 1, friction: 0.5, slip: 1e-4"
BALL = (
    "- {name: b, mass: 1, inertia: [0.004, 0.004, 0.004], position: [0, 0, 0.1], linear_velocity: [2, 0, 0]}",
    [f"- {{name: s, {KEYS}, shape: {{type: sphere, radius: 0.1}}}}"],
)
BOX = (
    f"- {{name: b, mass: 2, inertia: {SOLID}, position: [0, 0, 0.4], quaternion: {TURN.as_quat().tolist()}, "
    f"angular_velocity: {TURN.inv().apply(SPIN).tolist()}, linear_velocity: {TURN.inv().apply(SPEED).tolist()}}}",
    [
        f"- {{name: s{i}, {KEYS}, shape: {{type: sphere, radius: 0.03, position: {list(place)}}}}}"
        for i, place in enumerate(CORNERS)
    ],
)
SCENES = {"ball": BALL, "box": BOX}
ACCURACIES = (1e-2, 1e-4, 1e-6, 1e-9)


def scene_of(name):
    body, contacts = SCENES[name]
    return scene_from_text(
        "\n".join([f"name: {name}\ngravity: [0, 0, -9.81]\nbodies:", body, "forces:", *contacts]), name
    )


def own(name, accuracy):
    """(ms per simulated second, rotation matrix, estimate in rad) of the cheapest of some runs."""
    best = np.inf
    for _ in range(ROUNDS):
        simulation = Simulation(scene_of(name), accuracy=accuracy, quiet=True)
        simulation.advance_to(1e-9)
        start = time.process_time()
        simulation.advance_to(SECONDS)
        best = min(best, time.process_time() - start)
    sample = simulation.sample()
    return 1e3 * best / SECONDS, sample.pose[0, :9].reshape(3, 3), float(simulation.largest_error)


def of_drake(name, scheme, accuracy, step=None):
    """(ms per simulated second, rotation matrix) of Drake's continuous plant."""
    import pydrake.all as drake

    builder = drake.DiagramBuilder()
    plant, graph = drake.AddMultibodyPlantSceneGraph(builder, 0.0)

    def properties():
        made = drake.ProximityProperties()
        friction = drake.CoulombFriction(0.5, 0.5)
        drake.AddContactMaterial(dissipation=1.0, point_stiffness=1e5, friction=friction, properties=made)
        return made

    ground = plant.world_body(), drake.RigidTransform(), drake.HalfSpace()
    plant.RegisterCollisionGeometry(*ground, "ground", properties())
    is_ball = name == "ball"
    inertia = (
        drake.SpatialInertia.SolidSphereWithMass(1.0, 0.1)
        if is_ball
        else drake.SpatialInertia.SolidBoxWithMass(2.0, 0.4, 0.3, 0.1)
    )
    body = plant.AddRigidBody("b", inertia)
    for i, place in enumerate([(0.0, 0.0, 0.0)] if is_ball else CORNERS):
        shape = drake.RigidTransform(place), drake.Sphere(0.1 if is_ball else 0.03)
        plant.RegisterCollisionGeometry(body, *shape, f"s{i}", properties())
    plant.set_contact_model(drake.ContactModel.kPoint)
    plant.Finalize()
    simulator = drake.Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    turn = np.eye(3) if is_ball else TURN.as_matrix()
    pose = drake.RigidTransform(drake.RotationMatrix(turn), [0.0, 0.0, 0.1 if is_ball else 0.4])
    plant.SetFreeBodyPose(context, body, pose)
    twist = drake.SpatialVelocity((0.0, 0.0, 0.0), (2.0, 0.0, 0.0)) if is_ball else drake.SpatialVelocity(SPIN, SPEED)
    plant.SetFreeBodySpatialVelocity(context, body, twist)
    drake.ResetIntegratorFromFlags(simulator, scheme, 1e-3)
    integrator = simulator.get_mutable_integrator()
    if step is None:
        integrator.set_maximum_step_size(0.1)
        integrator.set_target_accuracy(accuracy)
    else:
        integrator.set_fixed_step_mode(True)
        integrator.set_maximum_step_size(step)
    simulator.Initialize()
    start = time.process_time()
    simulator.AdvanceTo(SECONDS)
    spent = time.process_time() - start
    return 1e3 * spent / SECONDS, plant.EvalBodyPoseInWorld(context, body).rotation().matrix()


def angle(one, other):
    """Angle between two rotations, rad."""
    return float(Rotation.from_matrix(one @ other.T).magnitude())


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", help="file for the figures")
    arguments, rows = parser.parse_args(), []
    has_drake = importlib.util.find_spec("pydrake") is not None
    for name in SCENES:
        _, exact, _ = own(name, 1e-11)
        for accuracy in ACCURACIES:
            cost, turn, estimate = own(name, accuracy)
            rows.append((name, "here", accuracy, cost, angle(turn, exact), estimate))
        if not has_drake:
            continue
        _, exact = of_drake(name, "runge_kutta3", 1e-9, step=5e-6)
        for scheme in ("cenic", "radau3", "runge_kutta3", "implicit_euler"):
            for accuracy in (1e-2, 1e-3, 1e-4, 1e-5, 1e-6):
                cost, turn = min((of_drake(name, scheme, accuracy) for _ in range(ROUNDS)), key=lambda each: each[0])
                rows.append((name, f"Drake {scheme}", accuracy, cost, angle(turn, exact), None))
    table = Table("scene", "program", "asked for", "CPU ms per s", "error, rad", "estimate, rad or of the size")
    for name, program, accuracy, cost, error, estimate in rows:
        shown = "-" if estimate is None else f"{estimate:.1e}"
        table.add_row(name, program, f"{accuracy:.0e}", f"{cost:.2f}", f"{error:.1e}", shown)
    Console(width=120).print(table)
    if arguments.json:
        keys = "scene", "program", "accuracy", "ms", "error", "estimate"
        with open(arguments.json, "w") as file:
            json.dump([dict(zip(keys, row)) for row in rows], file, indent=1)


if __name__ == "__main__":
    main()
