# SPDX-License-Identifier: Apache-2.0
"""Slider-crank with friction in its joints: scene, and kinematics in one coordinate."""

import cmath
import math

import numpy as np
import yaml
from scene_files import filled, text_of

from liegroup_core.scene.load import scene_from_text

G = 9.81
CRANK, ROD, ARM = 0.1, 0.3, 0.05
FRICTION = {"main": 0.02, "pin": 0.015, "wrist": 0.01, "slide": 0.8}


def slider_crank(angle, rate, friction, upper=None, restitution=0.0):
    """Slider-crank in the x, y plane with gravity along -y; friction : {joint: coulomb}."""
    tilt = -math.asin(CRANK * math.sin(angle) / ROD)
    end = CRANK * math.cos(angle) + ROD * math.cos(tilt)
    crank = {"name": "crank", "mass": 1.0, "inertia": [0.02] * 3, "com": [ARM, 0, 0]}
    crank |= {"rotation_vector": [0, 0, angle], "angular_velocity": [0, 0, rate], "initial": "fixed"}
    rod = {"name": "rod", "mass": 0.5, "inertia": [0.004] * 3, "com": [0.15, 0, 0]}
    rod |= {"position": [CRANK * math.cos(angle), CRANK * math.sin(angle), 0]}
    rod |= {"rotation_vector": [0, 0, tilt]}
    ram = {"name": "ram", "mass": 2.0, "inertia": [0.02] * 3, "position": [end, 0, 0]}
    joints = yaml.safe_load(filled(text_of("joints_of_a_slider_crank.yaml"), crank=CRANK, rod=ROD))
    for joint in joints:
        if joint["name"] in friction:
            joint["friction"] = {"coulomb": friction[joint["name"]]}
    if upper is not None:
        joints[3]["limits"] = {"upper": upper, "restitution": restitution}
    scene = {"name": "press", "gravity": [0, -G, 0], "assemble": True}
    scene |= {"bodies": [crank, rod, ram], "joints": joints}
    return scene_from_text(yaml.safe_dump(scene))


def kinematics(angle):
    """Inertia, potential, slide and rates of the joints by the crank's rate; angle may be complex."""
    s, c = cmath.sin(angle), cmath.cos(angle)
    sine = -CRANK * s / ROD
    cosine = cmath.sqrt(1.0 - sine * sine)
    turn = -CRANK * c / (ROD * cosine)
    slide = CRANK * c + ROD * cosine
    speed = -CRANK * s - ROD * sine * turn
    rod = (-CRANK * s - 0.15 * sine * turn, CRANK * c + 0.15 * cosine * turn)
    inertia = 0.02 + ARM**2 + 0.5 * (rod[0] ** 2 + rod[1] ** 2) + 0.004 * turn**2 + 2.0 * speed**2
    potential = G * (ARM * s + 0.5 * (CRANK * s + 0.15 * sine))
    return inertia, potential, slide, np.array([1.0, turn - 1.0, -turn, speed])
