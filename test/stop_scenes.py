# SPDX-License-Identifier: Apache-2.0
"""Scenes with stops and friction that several tests use."""

# Slider-crank whose ram has a stop and whose main bearing has friction.
PRESS = """
name: press
gravity: [0, 0, 0]
assemble: true
bodies:
  - {name: crank, mass: 1.0, inertia: [0.02, 0.02, 0.02], com: [0.05, 0, 0], initial: fixed,
      rotation_vector: [0, 0, 1.0], angular_velocity: [0, 0, -3]}
  - {name: rod, mass: 0.5, inertia: [0.02, 0.02, 0.02], com: [0.15, 0, 0],
      position: [0.05, 0.08, 0], rotation_vector: [0, 0, -0.2]}
  - {name: ram, mass: 2.0, inertia: [0.02, 0.02, 0.02], position: [0.34, 0, 0]}
joints:
  - {name: main, type: revolute, parent: world, child: crank, child_frame: {},
      friction: {coulomb: 0.05, static: 0.2}}
  - {name: pin, type: revolute, parent: crank, child: rod, parent_frame: {position: [0.1, 0, 0]},
      child_frame: {}}
  - {name: wrist, type: revolute, parent: rod, child: ram, parent_frame: {position: [0.3, 0, 0]},
      child_frame: {}}
  - {name: slide, type: prismatic, parent: world, child: ram, parent_frame: {axis: [1, 0, 0]},
      child_frame: {axis: [1, 0, 0]}, limits: {upper: 0.38}}
"""
