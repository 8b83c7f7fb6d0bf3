# SPDX-License-Identifier: Apache-2.0
"""Logs of simulated machines, as of real ones: inputs, noise, a late clock, lost messages, a start that is not given.

The outputs of the true machine come from `Simulation`, to an accuracy far below the noise, and not from the code that
compares.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from liegroup_core import Simulation
from liegroup_core.identification import Given, Log, Measured
from liegroup_core.scene.load import scene_from_text

PENDULUM = """
name: furuta
gravity: [0, 0, -9.81]
bodies:
  - {name: arm, shape: {type: rod, axis: [1, 0, 0], length: 0.3, radius: 0.01, mass: 0.4}, position: [0.15, 0, 0]}
  - {name: rod, shape: {type: rod, axis: [0, 0, 1], length: 0.4, radius: 0.005, mass: 0.15}, position: [0.3, 0, -0.2]}
joints:
  - {name: motor, type: revolute, parent: world, child: arm, parent_frame: {}, child_frame: {position: [-0.15, 0, 0]},
     MOTOR}
  - {name: hinge, type: revolute, parent: arm, child: rod, parent_frame: {position: [0.15, 0, 0], axis: [1, 0, 0]},
     child_frame: {position: [0, 0, 0.2], axis: [1, 0, 0]}, HINGE}
"""
FOUR_BAR = """
name: four_bar_motor
gravity: [0, -9.81, 0]
assemble: true
bodies:
  - {name: crank, shape: {type: box, size: [0.2, 0.03, 0.03], mass: 0.5}, position: [0, 0.1, 0],
     rotation_vector: [0, 0, 1.5707963267948966], initial: fixed}
  - {name: coupler, shape: {type: box, size: [0.5, 0.03, 0.03], mass: 0.6}, position: [0.22, 0.3, 0],
     rotation_vector: [0, 0, 0.4]}
  - {name: rocker, shape: {type: box, size: [0.4, 0.03, 0.03], mass: 0.8}, position: [0.45, 0.2, 0],
     rotation_vector: [0, 0, 1.6]}
joints:
  - {name: motor, type: revolute, parent: world, child: crank, parent_frame: {}, child_frame: {position: [-0.1, 0, 0]},
     MOTOR}
  - {name: pin, type: revolute, parent: crank, child: coupler, parent_frame: {position: [0.1, 0, 0]},
     child_frame: {position: [-0.25, 0, 0]}}
  - {name: ball, type: spherical, parent: coupler, child: rocker, parent_frame: {position: [0.25, 0, 0]},
     child_frame: {position: [0.2, 0, 0]}}
  - {name: hinge, type: revolute, parent: world, child: rocker, parent_frame: {position: [0.45, 0, 0]},
     child_frame: {position: [-0.2, 0, 0]}, HINGE}
"""
ARM = """
name: arm
gravity: [0, 0, -9.81]
bodies:
  - {name: upper, shape: {type: rod, axis: [1, 0, 0], length: 0.4, radius: 0.03, mass: 2}, position: [0.2, 0, 0]}
  - {name: lower, shape: {type: rod, axis: [1, 0, 0], length: 0.3, radius: 0.02, mass: 1}, position: [0.55, 0, 0]}
  - {name: hand, shape: {type: box, size: [0.1, 0.05, 0.05], mass: 0.3}, position: [0.75, 0, 0]}
joints:
  - {name: motor, type: revolute, parent: world, child: upper, parent_frame: {axis: [0, 1, 0]},
     child_frame: {position: [-0.2, 0, 0], axis: [0, 1, 0]}, MOTOR}
  - {name: hinge, type: revolute, parent: upper, child: lower, parent_frame: {position: [0.2, 0, 0], axis: [0, 1, 0]},
     child_frame: {position: [-0.15, 0, 0], axis: [0, 1, 0]}, HINGE}
  - {name: wrist, type: revolute, parent: lower, child: hand, parent_frame: {position: [0.15, 0, 0]},
     child_frame: {position: [-0.05, 0, 0]}}
"""
GRIPPER = """
name: gripper
gravity: [0, 0, -9.81]
bodies:
  - {name: palm, shape: {type: box, size: [0.1, 0.2, 0.04], mass: 0.8}, position: [0.05, 0, 0]}
  - {name: left, shape: {type: box, size: [0.1, 0.02, 0.03], mass: 0.15}, position: [0.15, 0.05, 0]}
  - {name: right, shape: {type: box, size: [0.1, 0.02, 0.03], mass: 0.16}, position: [0.15, -0.05, 0]}
joints:
  - {name: motor, type: revolute, parent: world, child: palm, parent_frame: {axis: [0, 1, 0]},
     child_frame: {position: [-0.05, 0, 0], axis: [0, 1, 0]}, MOTOR}
  - {name: hinge, type: prismatic, parent: palm, child: left, parent_frame: {position: [0.1, 0.05, 0], axis: [0, 1, 0]},
     child_frame: {axis: [0, 1, 0]}, HINGE}
  - {name: other, type: prismatic, parent: palm, child: right,
     parent_frame: {position: [0.1, -0.05, 0], axis: [0, 1, 0]}, child_frame: {axis: [0, 1, 0]}}
couplings: [{name: rack, joint: other, other: hinge, ratio: -1}]
"""
SWING = """
name: swing
gravity: [0, 0, -9.81]
bodies:
  - {name: rod, shape: {type: rod, axis: [0, 0, 1], length: 0.6, radius: 0.01, mass: 0.4}, position: [0, 0, -0.3]}
joints:
  - {name: hinge, type: revolute, parent: world, child: rod, parent_frame: {axis: [0, 1, 0]}, HINGE}
"""
DOUBLE = """
name: double
gravity: [0, 0, -9.81]
bodies:
  - {name: upper, shape: {type: rod, axis: [0, 0, 1], length: 0.4, radius: 0.01, mass: 0.3}, position: [0, 0, -0.2]}
  - {name: lower, shape: {type: rod, axis: [0, 0, 1], length: 0.3, radius: 0.01, mass: 0.2}, position: [0, 0, -0.55]}
joints:
  - {name: motor, type: revolute, parent: world, child: upper, parent_frame: {axis: [0, 1, 0]},
     child_frame: {position: [0, 0, 0.2], axis: [0, 1, 0]}, MOTOR}
  - {name: hinge, type: revolute, parent: upper, child: lower, parent_frame: {position: [0, 0, -0.2], axis: [0, 1, 0]},
     child_frame: {position: [0, 0, 0.15], axis: [0, 1, 0]}, HINGE}
"""
SLIDER_CRANK = """
name: slider_crank
gravity: [0, -9.81, 0]
assemble: true
bodies:
  - {name: crank, shape: {type: box, size: [0.1, 0.02, 0.02], mass: 0.4}, position: [0.05, 0, 0], initial: fixed}
  - {name: rod, shape: {type: box, size: [0.3, 0.02, 0.02], mass: 0.5}, position: [0.25, 0, 0]}
  - {name: slider, shape: {type: box, size: [0.06, 0.05, 0.05], mass: 0.8}, position: [0.4, 0, 0]}
joints:
  - {name: motor, type: revolute, parent: world, child: crank, parent_frame: {}, child_frame: {position: [-0.05, 0, 0]},
     MOTOR}
  - {name: pin, type: revolute, parent: crank, child: rod, parent_frame: {position: [0.05, 0, 0]},
     child_frame: {position: [-0.15, 0, 0]}}
  - {name: ball, type: spherical, parent: rod, child: slider, parent_frame: {position: [0.15, 0, 0]}}
  - {name: hinge, type: prismatic, parent: world, child: slider, parent_frame: {axis: [1, 0, 0]},
     child_frame: {axis: [1, 0, 0]}, HINGE}
"""
CART = """
name: cart
gravity: [0, 0, -9.81]
bodies:
  - {name: cart, shape: {type: box, size: [0.2, 0.1, 0.1], mass: 0.9}}
  - {name: pole, shape: {type: rod, axis: [0, 0, 1], length: 0.5, radius: 0.01, mass: 0.2}, position: [0, 0, -0.25]}
joints:
  - {name: motor, type: prismatic, parent: world, child: cart, parent_frame: {axis: [1, 0, 0]},
     child_frame: {axis: [1, 0, 0]}, MOTOR}
  - {name: hinge, type: revolute, parent: cart, child: pole, parent_frame: {axis: [0, 1, 0]},
     child_frame: {position: [0, 0, 0.25], axis: [0, 1, 0]}, HINGE}
"""
# Text, names of the actuated joints and how strongly they are driven in N m or N, and joints that start elsewhere.
MACHINES = {
    "furuta": (PENDULUM, {"motor": 0.25}, {}),
    "four_bar": (FOUR_BAR, {"motor": 1.5}, {}),
    "arm": (ARM, {"motor": 12.0, "hinge": 4.0, "wrist": 0.1}, {}),
    "gripper": (GRIPPER, {"motor": 2.0, "hinge": 0.5}, {}),
    "swing": (SWING, {}, {"hinge": (1.1, 0.0)}),
    "double": (DOUBLE, {}, {"motor": (1.2, 0.0), "hinge": (-0.6, 0.0)}),
    "slider_crank": (SLIDER_CRANK, {"motor": 1.0}, {}),
    "cart": (CART, {"motor": 4.0}, {"hinge": (0.5, 0.0)}),
}
DELAY, LOST = 0.004, 0.02
NOISE = {"position": 5e-4, "velocity": 5e-3}


def machine(name, motor="", hinge="", **replaced):
    """Scene of a machine with keys added to its joints, such as "friction: {viscous: 0.1}"."""
    text = MACHINES[name][0]
    for place, key in (("MOTOR", motor), ("HINGE", hinge)):
        text = text.replace(f",\n     {place}}}", f",\n     {key}}}" if key else "}")
        text = text.replace(f", {place}}}", f", {key}}}" if key else "}")
    for old, new in replaced.items():
        text = text.replace(old, new)
    return scene_from_text(text)


def log_of(true, name, seed, seconds=4.0, rate=250.0, delay=DELAY, scale=1.0):
    """Log of a true machine: efforts that change at 100 Hz, measured joints, random times, gaps and noise.

    scale : of the efforts that act, relative to those that are logged
    """
    rng = np.random.default_rng(seed)
    simulation = Simulation(true, quiet=True, accuracy=1e-8)
    simulation.place(joints=MACHINES[name][2])
    at = np.arange(0.0, seconds, 0.01)
    inputs = []
    for joint, size in MACHINES[name][1].items():
        phases, rates = rng.uniform(0.0, 2.0 * np.pi, 3), rng.uniform(2.0, 12.0, 3)
        u = size * np.sin(np.outer(at, rates) + phases).mean(axis=1)
        inputs.append(Given(f"{joint}.effort", at, u))
    times = 0.03 + np.cumsum(rng.uniform(0.7, 1.3, int((seconds - 0.1) * rate)) / rate)
    times = np.round(times[rng.uniform(size=len(times)) > LOST], 9)
    joints = [joint for joint in simulation.layout.coordinates.names if joint != "pin"]
    channels = [f"{joint}.{part}" for joint in joints for part in NOISE]
    rows, waiting = [], list(zip(at, *(each.values for each in inputs)))
    for time in times:
        while waiting and waiting[0][0] <= time:
            start, *values = waiting.pop(0)
            for each, value in zip(inputs, values):
                simulation.apply_effort(each.name.removesuffix(".effort"), scale * float(value), start=float(start))
        simulation.advance_to(time)
        found = simulation.sample(time).joint_coordinates
        rows.append([number for joint in joints for number in found[joint]])
    sigma = np.array([NOISE[channel.rpartition(".")[2]] for channel in channels])
    values = np.array(rows) + sigma * rng.standard_normal((len(times), len(sigma)))
    unknown = np.full(len(sigma), np.nan)
    return Log(tuple(inputs), (Measured("/joint_states", times + delay, tuple(channels), values, unknown),))


def seen_log_of(true, model, outputs, seed, joints=None, seconds=1.0, rate=100.0):
    """Log of outputs of a true machine without inputs, which starts elsewhere than the model; sensors have no noise.

    outputs : {name of a body, whose pose is measured, of a sensor, or of a joint: noise, of rotations twice that}
    joints  : {joint: (position, velocity)} at the start
    """
    rng, simulation = np.random.default_rng(seed), Simulation(true, quiet=True, accuracy=1e-8)
    simulation.place(joints=joints or {})
    turns = {body.name: Rotation.from_matrix(body.pose[:3, :3]) for body in model.bodies}
    times, channels, sigma, rows = np.arange(0.02, seconds, 1.0 / rate), [], [], []
    sensors = {sensor.name for sensor in true.sensors}
    for name, noise in outputs.items():
        if name in turns:
            channels += [f"{name}.{part}" for part in ("x", "y", "z", "rx", "ry", "rz")]
            sigma += [noise] * 3 + [2.0 * noise] * 3
        else:
            channels.append(f"{name}.0" if name in sensors else f"{name}.position")
            sigma.append(noise)
    for sample in simulation.samples(times):
        row = []
        for name, noise in outputs.items():
            if name not in turns:
                value = sample.sensors[name][0] if name in sensors else sample.joint_coordinates[name][0]
                row.append(value + noise * rng.standard_normal())
                continue
            pose = sample.poses[name]
            turn = Rotation.from_rotvec(2.0 * noise * rng.standard_normal(3))
            turn = turns[name].inv() * Rotation.from_matrix(pose[:3, :3]) * turn
            row += [*(pose[:3, 3] + noise * rng.standard_normal(3)), *turn.as_rotvec()]
        rows.append(row)
    return Log((), (Measured("/seen", times, tuple(channels), np.array(rows), np.array(sigma), 0.0),))


def driven_log_of(true, joints, outputs, seed, friction=(), seconds=1.5, noise=1e-4, delay=DELAY):
    """Log of a machine whose joints are driven: their positions at 250 Hz with noise, and measured outputs.

    joints  : {joint: size of its motion, rad}
    outputs : {JOINT.position, JOINT.velocity or JOINT.effort: noise}
    friction : {joint: (coulomb, viscous)} that the efforts overcome, too
    """
    rng, fine, motions, drives = np.random.default_rng(seed), np.linspace(0.0, seconds, int(500 * seconds) + 1), {}, []
    for joint, size in joints.items():
        a, w, p = size * rng.uniform(0.2, 0.5, 3), rng.uniform(2.0, 8.0, 3), rng.uniform(0.0, 6.0, 3)
        # From rest at zero: sums of sines without their value and rate at the start.
        turn = np.outer(fine, w) + p
        q = (a * (np.sin(turn) - np.sin(p) - np.outer(fine, w * np.cos(p)))).sum(axis=1)
        v, acceleration = (a * w * (np.cos(turn) - np.cos(p))).sum(axis=1), -(a * w**2 * np.sin(turn)).sum(axis=1)
        acceleration[-1] = 0.0
        values = fine.tolist(), q.tolist(), v.tolist(), acceleration.tolist()
        motions[joint] = dict(zip(("times", "positions", "velocities", "accelerations"), values))
        at = slice(0, None, 2)
        known = q[at] + noise * rng.standard_normal(len(q[at]))
        drives.append(Given(f"{joint}.motion", fine[at], known, "spline", noise))
    scene = true.remade(
        joints=[
            each.remade(driven=True, motion=motions[each.name]) if each.name in motions else each
            for each in true.joints
        ]
    )
    times = np.round(np.arange(0.04, seconds - 0.05, 0.0041), 9)
    rows, names = [], [name.split(".") for name in outputs]
    for sample in Simulation(scene, quiet=True, accuracy=1e-8).samples(times):
        found = {name: [*state, sample.drive_efforts.get(name)] for name, state in sample.joint_coordinates.items()}
        for joint, (coulomb, viscous) in dict(friction).items():
            found[joint][2] += coulomb * np.sign(found[joint][1]) + viscous * found[joint][1]
        rows.append([found[joint][("position", "velocity", "effort").index(part)] for joint, part in names])
    sigma = np.array(list(outputs.values()))
    values = np.array(rows) + sigma * rng.standard_normal((len(times), len(sigma)))
    unknown = np.full(len(sigma), np.nan)
    measured = Measured("/joint_states", times + delay, tuple(outputs), values, unknown)
    return Log((), (measured,), drives=tuple(drives))
