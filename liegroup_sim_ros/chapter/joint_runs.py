# SPDX-License-Identifier: Apache-2.0
"""Runs for Figs. 6.2, 6.4 and 6.5 of the chapter: constraint violation on three groups.

These are SE(3)^n and (SO(3) x R^3)^n as in the chapter, and the joint groups of a spanning tree.

Errors are computed from poses and joint frames directly, not from the engine's residuals.
Source: Müller and Terze, sections 6.2.6.1 and 6.2.6.2.
"""

import math
from dataclasses import dataclass

import numpy as np

from liegroup_core import Scene, Simulation, load_scene
from liegroup_core.lie.groups import SO3
from liegroup_core.methods.table import RELATIVE
from liegroup_core.motion_groups.table import FLOATING
from liegroup_core.scene.description import Body, Frame, Joint

GROUPS = (*FLOATING, RELATIVE)
STEPS = (1e-2, 1e-3, 1e-4)  # s
TOP_HORIZON, BAR_HORIZON = 6.0, 1.0  # s
# Horizon at step 1e-2 s: soon after, the energy error of the four-bar is 20 %.
SHORT_HORIZON = 0.15  # s
SAMPLES = 1000  # per run, at most
CRANK_RATE = 10.0 * math.pi  # rad/s


@dataclass(frozen=True, eq=False)
class JointErrors:
    """Joint errors of a run with k samples of a scene with m joints."""

    group: str
    step: float  # s
    times: np.ndarray  # (k,) s
    joints: tuple  # (m,) names
    gap: np.ndarray  # (k, m) m, distance between the origins of the two frames
    tilt: np.ndarray  # (k, m) sine of the angle between their z axes, for joints with an
    #                         axis; else 0
    poses: np.ndarray  # (k, n, 4, 4)
    energy: np.ndarray  # (k,) J


def joint_errors(scene, step, group, horizon, samples=SAMPLES):
    """Integrate a scene by rkmk4 without stabilisation; returns JointErrors."""
    simulation = Simulation(scene, method="rkmk4", step=step, group=group)
    steps = round(horizon / step)
    every = max(1, steps // samples)
    times, poses, energy = [], [], []
    for k in range(steps // every + 1):
        simulation.advance(k * every - simulation.steps)
        sample = simulation.sample()
        times.append(sample.time)
        poses.append(sample.pose_matrices)
        energy.append(sample.energy)
    poses = np.array(poses)
    index = {name: i for i, name in enumerate(simulation.layout.body_names)}
    gap, tilt = np.zeros((2, len(poses), len(scene.joints)))
    for j, (joint, (F_a, F_b)) in enumerate(zip(scene.joints, simulation.layout.joint_frames)):
        parent = F_a if joint.parent == "world" else poses[:, index[joint.parent]] @ F_a
        child = poses[:, index[joint.child]] @ F_b
        gap[:, j] = np.linalg.norm(child[:, :3, 3] - parent[..., :3, 3], axis=-1)
        if joint.type == "revolute":
            across = np.cross(np.broadcast_to(parent[..., :3, 2], child[:, :3, 2].shape), child[:, :3, 2])
            tilt[:, j] = np.linalg.norm(across, axis=-1)
    return JointErrors(
        group, step, np.array(times), tuple(joint.name for joint in scene.joints), gap, tilt, poses, np.array(energy)
    )


def heavy_top_runs(say=lambda text: None):
    """{(group, step): JointErrors} of Fig. 6.2; say: called with the name of each run."""
    return _runs("Fig. 6.2", load_scene("heavy_top"), lambda step: TOP_HORIZON, say)


def four_bar_runs(say=lambda text: None):
    """{(group, step): JointErrors} of Figs. 6.4 and 6.5; say: called with the name of each run."""
    return _runs("Figs. 6.4 and 6.5", four_bar(), lambda step: SHORT_HORIZON if step == STEPS[0] else BAR_HORIZON, say)


def _runs(name, scene, horizon, say):
    runs = {}
    for group in GROUPS:
        for step in STEPS:
            say(f"{name}, rkmk4 on {group}, {step:g} s")
            runs[group, step] = joint_errors(scene, step, group, horizon(step))
    return runs


def four_bar(ball="coupler_rocker"):
    """Planar four-bar of crank 0.5 m, coupler, rocker and ground 1 m; no gravity.

    ball : name of the spherical joint; the other joints are revolute about z
    Uniform bars of 0.5, 1 and 1 kg with a square section of 50 mm, x along the bar. The crank
    starts at 90 degrees and rotates at 10 pi rad/s; the rocker leans away from it.
    """
    pin, tip = np.array([1.0, 0.0]), np.array([0.0, 0.5])
    # Coupler and rocker are the sides, each 1 m, of a triangle over the line from crank tip to ground pin.
    base = pin - tip
    length = math.hypot(*base)
    corner = (tip + pin) / 2.0 + math.sqrt(1.0 - length**2 / 4.0) * _turned(base) / length
    # Both give the corner the same velocity: v + w2 x (corner - tip) = w3 x (corner - pin).
    tip_velocity = CRANK_RATE * _turned(tip)
    sides = np.array([_turned(corner - tip), -_turned(corner - pin)]).T
    coupler_rate, rocker_rate = np.linalg.solve(sides, -tip_velocity)
    at_rest = np.zeros(2)
    kinds = dict.fromkeys(("ground_crank", "crank_coupler", "coupler_rocker", "ground_rocker"), "revolute") | {
        ball: "spherical"
    }
    ends = {
        "ground_crank": ("world", "crank", -0.25),
        "crank_coupler": ("crank", "coupler", -0.5),
        "coupler_rocker": ("coupler", "rocker", 0.5),
        "ground_rocker": ("world", "rocker", -0.5),
    }
    return Scene(
        name="four_bar",
        gravity=(0.0, 0.0, 0.0),
        bodies=[
            _bar("crank", 0.5, at_rest, tip, CRANK_RATE, at_rest),
            _bar("coupler", 1.0, tip, corner, coupler_rate, tip_velocity),
            _bar("rocker", 1.0, pin, corner, rocker_rate, at_rest),
        ],
        joints=[
            Joint(
                name=name,
                type=kind,
                parent=ends[name][0],
                child=ends[name][1],
                child_frame=Frame(position=(ends[name][2], 0.0, 0.0)),
            )
            for name, kind in kinds.items()
        ],
    )


def _bar(name, mass, start, end, rate, start_velocity):
    along = end - start
    length, width = math.hypot(*along), 0.05
    turn = np.array([0.0, 0.0, math.atan2(along[1], along[0])])
    velocity = np.append(start_velocity + rate * _turned(along) / 2.0, 0.0)
    across = mass * (length**2 + width**2) / 12.0
    return Body(
        name=name,
        mass=mass,
        inertia=(mass * width**2 / 6.0, across, across),
        position=(*(start + end) / 2.0, 0.0),
        rotation_vector=turn,
        angular_velocity=(0.0, 0.0, rate),
        linear_velocity=SO3.exp(turn).T @ velocity,
    )


def _turned(vector):
    """Vector in the plane, rotated by 90 degrees."""
    return np.array([-vector[1], vector[0]])
