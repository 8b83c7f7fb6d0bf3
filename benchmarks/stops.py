# SPDX-License-Identifier: Apache-2.0
"""Stops and friction compared with MuJoCo and Drake: CPU time, and true error against closed forms.

    python benchmarks/stops.py [--json FILE]

    rest     a pendulum falls on a stop without rebound and rests there: its angle after 5 s
    bounce   a pendulum bounces off a stop at its lowest point, restitution 0.7: its angle after 3 s
    slope    a block is pushed up a slope, stops by dry friction and stays: its place after 10 s

    robot    a chain of 20 hinges, each with two stops and dry friction, falls: events, and the longest step

MuJoCo's stops and dry friction are soft constraints. Its stop has the stiffness and damping that give the
restitution, as stiff as the step permits; without rebound it has the default. Drake's limits are
constraints of its SAP solver; it has no restitution and no dry friction of joints. Packages that are not
installed are reported and omitted.
"""

import argparse
import importlib.util
import json
import math
import statistics
import time

import mpmath
from rich.console import Console
from rich.table import Table

from liegroup_core.engine import Engine
from liegroup_core.scene.load import scene_from_text

G, MASS, LENGTH, INERTIA = 9.81, 1.3, 0.8, 0.05
MOMENT, ABOUT_PIVOT = MASS * LENGTH * G, INERTIA + MASS * LENGTH**2
START, REST, REBOUND = 2.0, 0.4, 0.7
TILT, FRICTION, SPEED, BLOCK = 0.3, 8.0, 1.7, 2.0
ROUNDS = 3
PENDULUM = """
name: pendulum
gravity: [0, 0, -9.81]
bodies:
  - {name: bob, mass: 1.3, inertia: [0.05, 0.05, 0.05], com: [0, 0, -0.8], rotation_vector: [2, 0, 0]}
joints:
  - name: pivot
    type: revolute
    parent: world
    child: bob
    parent_frame: {rotation_vector: [0, 1.5707963267948966, 0]}
    child_frame: {rotation_vector: [0, 1.5707963267948966, 0]}
    limits: {lower: LOWER, restitution: REBOUND}
"""
SLOPE = """
name: slope
gravity: [0, 0, -9.81]
bodies:
  - {name: block, mass: 2, inertia: [0.1, 0.1, 0.1], rotation_vector: [0, TURN, 0],
      linear_velocity: [0, 0, -1.7]}
joints:
  - name: track
    type: prismatic
    parent: world
    child: block
    parent_frame: {rotation_vector: [0, TURN, 0]}
    child_frame: {}
    friction: {coulomb: 8.0}
"""


def bounce_angle(at):
    """Angle of the bouncing pendulum at a time, by Jacobi's elliptic functions."""
    small = mpmath.sqrt(mpmath.mpf(MOMENT) / ABOUT_PIVOT)
    k = mpmath.sin(mpmath.mpf(START) / 2)
    begin, quarter = 0, mpmath.ellipk(k**2) / small
    if at < quarter:
        return float(2 * mpmath.asin(k * mpmath.ellipfun("cd", small * at, m=k**2)))
    begin = quarter
    while True:
        k *= REBOUND
        swing = 2 * mpmath.ellipk(k**2) / small
        if at < begin + swing:
            return float(2 * mpmath.asin(k * mpmath.ellipfun("sn", small * (at - begin), m=k**2)))
        begin += swing


PROBLEMS = {  # name: (seconds, true coordinate at the end)
    "rest": (5.0, REST),
    "bounce": (3.0, bounce_angle(3.0)),
    "slope": (10.0, -(SPEED**2) / (2.0 * (FRICTION / BLOCK + G * math.sin(TILT)))),
}


def ours(problem, step):
    """(name of the code, function that returns (coordinate, CPU s))."""
    text = SLOPE.replace("TURN", repr(0.5 * math.pi + TILT))
    if problem != "slope":
        stop = (REST, 0.0) if problem == "rest" else (0.0, REBOUND)
        text = PENDULUM.replace("LOWER", str(stop[0])).replace("REBOUND", str(stop[1]))
    engine = Engine(scene_from_text(text), "rkmk4", step)

    def run(seconds):
        engine.reset()
        start = time.process_time()
        engine.advance(round(seconds / step))
        taken = time.process_time() - start
        return next(iter(engine.sample().joint_coordinates.values()))[0], taken

    return "ours, rkmk4", run


def mujoco_run(problem, step):
    """Same as `ours` in MuJoCo, with its integrator RK4."""
    import mujoco

    solref = "0.02 1"
    if problem == "bounce":
        # e = exp(-pi zeta / sqrt(1 - zeta^2)); stiffer contacts than one of 15 steps miss this value.
        log = -math.log(REBOUND)
        zeta = log / math.hypot(math.pi, log)
        frequency = math.pi / (15.0 * step)
        solref = f"{-(frequency**2)} {-2.0 * zeta * frequency}"
    stop = f'limited="true" range="{REST if problem == "rest" else 0.0} 10" solreflimit="{solref}"'
    body = f"""<body euler="2 0 0"><joint type="hinge" axis="1 0 0" pos="0 0 0" ref="2" {stop}/>
      <inertial mass="{MASS}" pos="0 0 {-LENGTH}" diaginertia="{INERTIA} {INERTIA} {INERTIA}"/></body>"""
    if problem == "slope":
        body = f"""<body euler="0 {0.5 * math.pi + TILT} 0">
          <joint type="slide" axis="0 0 1" frictionloss="{FRICTION}"/>
          <inertial mass="{BLOCK}" pos="0 0 0" diaginertia="0.1 0.1 0.1"/></body>"""
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><option timestep="{step}" integrator="RK4" '
        f'gravity="0 0 {-G}"/><worldbody>{body}</worldbody></mujoco>'
    )
    data = mujoco.MjData(model)

    def run(seconds):
        mujoco.mj_resetData(model, data)
        if problem == "slope":
            data.qvel[0] = -SPEED
        steps = round(seconds / step)
        start = time.process_time()
        mujoco.mj_step(model, data, steps)
        return float(data.qpos[0]), time.process_time() - start

    return "MuJoCo, RK4", run


def drake_run(problem, step):
    """Same as `ours` in Drake, which supports only the stop without rebound."""
    if problem != "rest":
        return None
    from pydrake.all import (
        DiscreteContactApproximation,
        MultibodyPlant,
        RevoluteJoint,
        Simulator,
        SpatialInertia,
        UnitInertia,
    )

    plant = MultibodyPlant(step)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
    unit = UnitInertia(*(INERTIA / MASS + LENGTH**2,) * 2, INERTIA / MASS)
    body = plant.AddRigidBody("bob", SpatialInertia(MASS, [0, 0, -LENGTH], unit))
    frames = plant.world_frame(), body.body_frame()
    joint = plant.AddJoint(RevoluteJoint("pivot", *frames, [1, 0, 0], REST, 10.0))
    plant.mutable_gravity_field().set_gravity_vector([0, 0, -G])
    plant.Finalize()
    simulator = Simulator(plant)
    context = simulator.get_mutable_context()

    def run(seconds):
        context.SetTime(0.0)
        joint.set_angle(context, START)
        joint.set_angular_rate(context, 0.0)
        simulator.Initialize()
        start = time.process_time()
        simulator.AdvanceTo(seconds)
        return joint.get_angle(context), time.process_time() - start

    return "Drake, SAP", run


CODES = {  # steps, s
    "liegroup_core": (ours, (2e-2, 1e-2, 5e-3, 2e-3)),
    "mujoco": (mujoco_run, (2e-3, 1e-3, 2e-4, 5e-5)),
    "pydrake": (drake_run, (2e-3, 1e-3, 2e-4)),
}


def falling_robot(joints=20, step=2e-3, steps=750):
    """(events, median CPU s of a step without events, of an event, largest wall time of a step in s)."""
    bodies = [{"name": "b0", "mass": 1.0, "inertia": [0.02, 0.03, 0.025]}]
    links = [{"name": "base", "type": "fixed", "parent": "world", "child": "b0", "child_frame": {}}]
    for i in range(1, joints + 1):
        turn = [0.9 * math.sin(1.7 * i), 0.9 * math.cos(2.3 * i), 0.0]
        bodies.append({**bodies[0], "name": f"b{i}", "position": [0.3 * i, 0.0, 0.0]})
        links.append(
            {
                "name": f"j{i}",
                "type": "revolute",
                "parent": f"b{i - 1}",
                "child": f"b{i}",
                "child_frame": {"position": [-0.3, 0.0, 0.0], "rotation_vector": turn},
                "limits": {"lower": -0.4, "upper": 0.6, "restitution": 0.3},
                "friction": {"coulomb": 1.0, "static": 1.3},
            }
        )
    scene = {"name": "chain", "gravity": [0, 0, -9.81], "bodies": bodies, "joints": links}
    engine = Engine(scene_from_text(json.dumps(scene)), "rkmk4", step)
    plain, with_events, count, longest = [], 0.0, 0, 0.0
    for _ in range(steps):
        start, wall = time.process_time(), time.perf_counter()
        engine.advance(1)
        longest = max(longest, time.perf_counter() - wall)
        taken, events = time.process_time() - start, len(engine.drain_events())
        count += events
        if events:
            with_events += taken
        else:
            plain.append(taken)
    return count, statistics.median(plain), with_events / count, longest


def main():
    """Measure, and print one table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", help="also write the figures to this file")
    given = parser.parse_args()
    console, rows = Console(), []
    for package in [name for name in CODES if importlib.util.find_spec(name) is None]:
        console.print(f"{package} is not installed: omitted")
    for problem, (seconds, true) in PROBLEMS.items():
        for package, (make, steps) in CODES.items():
            if importlib.util.find_spec(package) is None:
                continue
            for step in steps:
                made = make(problem, step)
                if made is None:
                    continue
                code, run = made
                runs = [run(seconds) for _ in range(ROUNDS)]
                cost = statistics.median(taken for _, taken in runs) / seconds
                rows.append((problem, code, step, abs(runs[0][0] - true), cost))
    table = Table(title="Error at the end, rad or m, and CPU ms per simulated second")
    for head in ("problem", "code", "step, s", "error", "CPU ms/s"):
        table.add_column(head, justify="left" if head in ("problem", "code") else "right")
    for problem, code, step, error, cost in rows:
        table.add_row(problem, code, f"{step:g}", f"{error:.1e}", f"{1e3 * cost:.2f}")
    console.print(table)
    count, plain, event, longest = falling_robot()
    console.print(
        f"falling robot, 20 joints, 2 ms: {count} events in 1.5 s; CPU {1e6 * plain:.0f} us a step without "
        f"events, {1e3 * event:.2f} ms an event; longest step {1e3 * longest:.1f} ms"
    )
    rows.append(("robot", "ours, rkmk4", 2e-3, count, plain, event, longest))
    if given.json:
        with open(given.json, "w") as file:
            json.dump(rows, file, indent=1)


if __name__ == "__main__":
    main()
