# SPDX-License-Identifier: Apache-2.0
"""Contacts compared with Drake's continuous plant: CPU time against error, and the estimate of the error.

    python benchmarks/contacts.py [bodies | same | robots | drop] [--json FILE]

    ball     it skids on a plane and then rolls
    box      on four spheres it is thrown on a plane, tumbles and comes to rest
    robots   of example-robot-data fall 1 cm on the ground; servos hold their pose for 5 s. All collision shapes touch

Stiffness 1e5 N/m, dissipation 1 s/m, friction 0.5: the same normal force as Drake's point contact, which is that of
Hunt and Crossley; of two surfaces it has two springs in series. Without friction both programs have the same motion:
`same` prints the largest difference of poses. Its friction is regularised, ours yields by a length, so there each is
compared with itself at the tightest accuracy: Drake at 1e-10, where its radau3 agrees to 3e-10. Drake
(`pip install drake`) is omitted if it is not installed.

    drop     a ball drops 0.2 m and bounces without friction, dissipation 0.1 s/m, also in Exudyn (`pip install exudyn`)

Exudyn's Hunt-Crossley model has the dissipation 3 (1 - e) / 2 v of an impact speed v, at least `minimumImpactVelocity`:
with one above all speeds it is the same law. MuJoCo is no peer: its force depends on the acceleration without contact.
Of a ball that drops it begins, at a depth of zero, with the part solimp of the weight, 4.9 N of 9.8 N with 0.5,
whatever solref is; only without gravity it is a spring from zero.
"""

import argparse
import importlib.util
import itertools
import json
import tempfile
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from liegroup_core import Simulation
from liegroup_core.robots.read import read_robot
from liegroup_core.scene.load import load_scene, scene_from_text

SECONDS, ROUNDS = 2.0, 3
CORNERS = [(x, y, -0.05) for x in (0.2, -0.2) for y in (0.15, -0.15)]
TURN, SPIN, SPEED = Rotation.from_euler("ZYX", [0.1, 0.2, 0.3]), (1.0, 2.0, 0.5), (0.5, 0.3, 0.0)
SOLID = [2.0 / 12.0 * (a * a + b * b) for a, b in ((0.3, 0.1), (0.4, 0.1), (0.4, 0.3))]
SLIDES = ", friction: 0.5, slip: 1e-4"
KEYS = f"type: contact, body: b, stiffness: 1e5, damping: 1{SLIDES}"
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
# {robot: (file, SRDF file with its pose, links that touch if not all)}, in the folder of example-robot-data.
ROBOTS = {
    "A1": ("a1_description/urdf/a1.urdf", "a1_description/srdf/a1.srdf", ""),
    "Go1": ("go1_description/urdf/go1.urdf", "go1_description/srdf/go1.srdf", ""),
    "Go2": ("go2_description/urdf/go2.urdf", "go2_description/srdf/go2.srdf", ""),
    "B1": ("b1_description/urdf/b1.urdf", "b1_description/srdf/b1.srdf", ""),
    "Laikago": ("laikago_description/urdf/laikago.urdf", "", ""),
    "HyQ": ("hyq_description/robots/hyq_no_sensors.urdf", "hyq_description/srdf/hyq.srdf", ""),
    "Solo8": ("solo_description/robots/solo.urdf", "", ""),
    "Solo12": ("solo_description/robots/solo12.urdf", "solo_description/srdf/solo.srdf", ""),
    "ANYmal B": ("anymal_b_simple_description/robots/anymal.urdf", "anymal_b_simple_description/srdf/anymal.srdf", ""),
    "ANYmal C": ("anymal_c_simple_description/urdf/anymal.urdf", "anymal_c_simple_description/srdf/anymal.srdf", ""),
    "Bolt": ("bolt_description/robots/bolt.urdf", "bolt_description/srdf/bolt.srdf", ""),
    "Talos": (
        "talos_data/robots/talos_reduced.urdf",
        "talos_data/srdf/talos.srdf",
        "leg_left_6_link, leg_right_6_link",
    ),
    "TIAGo": (
        "tiago_description/robots/tiago_no_hand.urdf",
        "",
        "wheel_left_link, wheel_right_link, caster_back_left_2_link, caster_back_right_2_link, "
        "caster_front_left_2_link, caster_front_right_2_link",
    ),
}
HOLD, DROP, DAMPING, LENGTH = 2.0, 0.01, 0.02, 0.4  # weight times m; m; s; m


def scene_of(name, friction=True):
    body, contacts = SCENES[name]
    text = "\n".join([f"name: {name}\ngravity: [0, 0, -9.81]\nbodies:", body, "forces:", *contacts])
    return scene_from_text(text if friction else text.replace(SLIDES, ""), name)


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


def of_drake(name, scheme, accuracy, step=None, friction=0.5, end=SECONDS):
    """(ms per simulated second, rotation matrix, position) of Drake's continuous plant."""
    import pydrake.all as drake

    builder = drake.DiagramBuilder()
    plant, graph = drake.AddMultibodyPlantSceneGraph(builder, 0.0)

    def properties():
        made = drake.ProximityProperties()
        kind = drake.CoulombFriction(friction, friction)
        drake.AddContactMaterial(dissipation=1.0, point_stiffness=2e5, friction=kind, properties=made)
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
    simulator.AdvanceTo(end)
    spent, pose = time.process_time() - start, plant.EvalBodyPoseInWorld(context, body)
    return 1e3 * spent / end, pose.rotation().matrix(), pose.translation()


def of_same():
    """[(scene, accuracy, Drake's step in us, largest difference of position in m and of rotation matrices)] at 1 s."""
    rows = []
    for name in SCENES:
        theirs = {step: of_drake(name, "runge_kutta3", 1e-9, step, 0.0, 1.0) for step in (2e-5, 1e-5)}
        for accuracy, (step, (_, turn, place)) in itertools.product((1e-3, 1e-9), theirs.items()):
            simulation = Simulation(scene_of(name, friction=False), accuracy=accuracy, quiet=True)
            simulation.advance_to(1.0)
            pose = simulation.sample().pose[0]
            apart = np.abs(pose - np.concatenate([turn.ravel(), place])).max()
            rows.append((name, accuracy, 1e6 * step, float(apart)))
    return rows


def of_drop():
    """[(program, accuracy or step in s, CPU ms per s, error of the height in m)] after 0.5 s, against SciPy."""

    def rates(_, y):
        return [y[1], max(0.0, 1e5 * (0.1 - y[0]) * (1.0 - 0.1 * y[1])) * (y[0] < 0.1) - 9.81]

    exact = solve_ivp(rates, (0.0, 0.5), [0.3, 0.0], "DOP853", rtol=1e-12, atol=1e-13, max_step=1e-5).y[0, -1]
    text = BALL[0].replace("0.1], linear_velocity: [2, 0, 0]", "0.3]"), BALL[1][0].replace(SLIDES, "")
    text = "\n".join(["name: drop\ngravity: [0, 0, -9.81]\nbodies:", text[0], "forces:", text[1]])
    made, rows = scene_from_text(text.replace("damping: 1", "damping: 0.1"), "drop"), []

    def timed(run):
        pairs = [run() for _ in range(ROUNDS)]
        return 2e3 * min(spent for spent, _ in pairs), abs(pairs[0][1] - exact)

    def own(accuracy):
        simulation = Simulation(made, accuracy=accuracy, quiet=True)
        simulation.advance_to(1e-9)
        start = time.process_time()
        simulation.advance_to(0.5)
        return time.process_time() - start, simulation.sample().pose[0, 11]

    rows = [("here", accuracy, *timed(lambda: own(accuracy))) for accuracy in ACCURACIES]
    if importlib.util.find_spec("exudyn") is not None:
        for name, step in itertools.product(("RK44", "TrapezoidalIndex2"), (1e-3, 1e-4, 1e-5)):
            rows.append((f"Exudyn {name}", step, *timed(lambda: of_exudyn(name, step))))
    return rows


def of_exudyn(solver, step):
    """(CPU s, height in m) of the ball of `of_drop` after 0.5 s."""
    import exudyn
    from exudyn import utilities as items

    system = exudyn.SystemContainer().AddSystem()
    ground = system.AddObject(items.ObjectGround(referencePosition=[0, 0, -1]))
    ball = system.CreateRigidBody(
        referencePosition=[0, 0, 0.3], inertia=items.InertiaSphere(1, 0.1), gravity=[0, 0, -9.81],
        nodeType=exudyn.NodeType.RotationRotationVector,
    )  # fmt: skip
    system.AddObject(
        items.ObjectContactSphereSphere(
            markerNumbers=[system.AddMarker(items.MarkerBodyRigid(bodyNumber=body)) for body in (ground, ball)],
            nodeNumber=system.AddNode(
                items.NodeGenericData(initialCoordinates=[0.1, 0, 0, 0], numberOfDataCoordinates=4)
            ),
            spheresRadii=[1, 0.1], contactStiffness=1e5, impactModel=1, restitutionCoefficient=0.5,
            minimumImpactVelocity=7.5,
        )
    )  # fmt: skip
    position = exudyn.OutputVariableType.Position
    system.Assemble()
    settings = exudyn.SimulationSettings()
    settings.timeIntegration.endTime, settings.timeIntegration.numberOfSteps = 0.5, round(0.5 / step)
    settings.timeIntegration.verboseMode, settings.solutionSettings.writeSolutionToFile = 0, False
    start = time.process_time()
    system.SolveDynamic(settings, solverType=getattr(exudyn.DynamicSolverType, solver))
    return time.process_time() - start, system.GetObjectOutputBody(ball, position)[2]


def robot_scene(path, srdf, links, folder):
    """Scene of a robot above the ground, with servos and a law whose state is their work and that of dampers."""
    pose, robot = "", read_robot(path, srdf or None, {})
    if robot.poses:
        pose = next(iter(robot.poses))
    keys = f"robot: {path}\nbase: floating\nstops: []\nfriction: []\nground: {{friction: 0.8, links: [{links}]}}\n"
    if pose:
        keys += f"srdf: {srdf}\npose: {pose}\n"

    def scene(more=""):
        file = folder / "robot.yaml"
        file.write_text(keys + more)
        return load_scene(file)

    plain, file_names = scene(), {joint.name for joint in robot.joints}
    stiffness = HOLD * LENGTH * 9.81 * sum(body.mass for body in plain.bodies)
    damping = DAMPING * stiffness
    at = dict.fromkeys(file_names, 0.0) | robot.poses.get(pose, {})
    moving = [joint.name for joint in plain.joints if joint.name in file_names]
    root = plain.bodies[0]
    place = (root.position[0], root.position[1], root.position[2] + DROP)
    hold = f"servos: {{stiffness: {stiffness}, damping: {damping}, joints: [{', '.join(moving)}]}}\n"
    limits = {force.joint: force.effort_limit for force in scene(hold).forces if force.type.endswith("servo")}
    inputs, powers = [], []
    for k, name in enumerate(moving):
        inputs.append(f"q{k}: {name}.position, w{k}: {name}.velocity")
        dampers = [force for force in plain.forces if force.type in ("torsional_spring_damper", "linear_spring_damper")]
        also = sum(damper.damping for damper in dampers if damper.joint == name)
        effort = f"{stiffness}*({at[name]} - q{k}) - {damping}*w{k}"
        if limits[name] is not None:
            effort = f"clip({effort}, -{limits[name]}, {limits[name]})"
        powers.append(f"    p{k}: w{k}*({effort} - {also}*w{k})\n")
    total = " + ".join(f"p{k}" for k in range(len(moving)))
    meter = f"  - name: meter\n    type: law\n    inputs: {{{', '.join(inputs)}}}\n    signals:\n"
    meter += "".join(f"  {each}" for each in powers) + f"    states: {{work: {{rate: {total}, scale: 10}}}}\n"
    return scene(f"start: {{{root.name}: {{position: {list(place)}}}}}\n{hold}forces:\n{meter}")


def of_robots(share):
    """[(robot, accuracy, bodies, points, CPU s per s, largest estimate, J that do not add up, height in m)]."""
    rows = []
    for name, (file, srdf, links) in ROBOTS.items():
        for accuracy in (1e-3, 1e-4):
            with tempfile.TemporaryDirectory() as folder:
                scene = robot_scene(share / file, srdf and share / srdf, links, Path(folder))
            contacts = [force for force in scene.forces if force.type == "contact"]
            points = sum(len(force.as_law.outputs) for force in contacts)
            simulation = Simulation(scene, accuracy=accuracy, quiet=True)
            before = simulation.sample().energy
            simulation.advance_to(1e-9)
            start = time.process_time()
            simulation.advance_to(5.0)
            spent = (time.process_time() - start) / 5.0
            sample = simulation.sample()
            works = sum(sample.signals[f"{each}.work"] for each in ("meter", *(force.name for force in contacts)))
            lost, height = sample.energy - before - works, sample.pose[0, 11]
            rows.append((name, accuracy, len(scene.bodies), points, spent, simulation.largest_error, lost, height))
    return rows


def angle(one, other):
    """Angle between two rotations, rad."""
    return float(Rotation.from_matrix(one @ other.T).magnitude())


def of_bodies():
    """[(scene, program, accuracy, CPU ms per s, error in rad, estimate in rad or of the size)]."""
    rows, has_drake = [], importlib.util.find_spec("pydrake") is not None
    for name in SCENES:
        _, exact, _ = own(name, 1e-11)
        for accuracy in ACCURACIES:
            cost, turn, estimate = own(name, accuracy)
            rows.append((name, "here", accuracy, cost, angle(turn, exact), estimate))
        if not has_drake:
            continue
        _, exact, _ = of_drake(name, "runge_kutta3", 1e-10)
        for scheme in ("cenic", "radau3", "runge_kutta3", "implicit_euler"):
            for accuracy in (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-8):
                runs = [of_drake(name, scheme, accuracy) for _ in range(ROUNDS)]
                cost, turn, _ = min(runs, key=lambda each: each[0])
                rows.append((name, f"Drake {scheme}", accuracy, cost, angle(turn, exact), None))
    return rows


COLUMNS = {
    "bodies": ("scene", "program", "accuracy", "CPU ms per s", "error, rad", "estimate, rad or of the size"),
    "same": ("scene", "accuracy", "Drake's step, us", "largest difference"),
    "drop": ("program", "accuracy or step, s", "CPU ms per s", "error, m"),
    "robots": ("robot", "accuracy", "bodies", "points", "CPU s per s", "estimate", "J lost", "height, m"),
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", nargs="?", choices=COLUMNS, default="bodies")
    parser.add_argument("--folder", type=Path, help="robots of example-robot-data; default: those of the package")
    parser.add_argument("--json", help="file for the figures")
    arguments = parser.parse_args()
    if arguments.what == "robots":
        folder = arguments.folder
        if folder is None:
            cmeel = importlib.util.find_spec("cmeel")
            if cmeel is None:
                parser.error("pip install example-robot-data, or give --folder")
            folder = Path(cmeel.origin).parents[1] / "cmeel.prefix/share/example-robot-data/robots"
        rows = of_robots(folder)
    else:
        rows = {"same": of_same, "drop": of_drop, "bodies": of_bodies}[arguments.what]()
    keys = COLUMNS[arguments.what]
    table = Table(*keys)
    for row in rows:
        table.add_row(*(f"{each:.3g}" if isinstance(each, float) else str(each or "-") for each in row))
    Console(width=120).print(table)
    if arguments.json:
        with open(arguments.json, "w") as file:
            json.dump([dict(zip(keys, row)) for row in rows], file, indent=1)


if __name__ == "__main__":
    main()
