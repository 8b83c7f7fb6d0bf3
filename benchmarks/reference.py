# SPDX-License-Identifier: Apache-2.0
"""Reference integration: time that it reaches, its cost, and its uncertainty beside the error of a default run.

    python -P benchmarks/reference.py [--seconds 300] [--cpu 600] [--only NAME ...]

Every example scene and mechanisms that are none: random closed loops, a stiff damped spring, a spatial four-bar with
ball joints. Prints
    reached      s, simulated time; less than requested if the integration ends or its CPU time does
    CPU          s per second of motion, both integrations, without compiling
    uncertainty  relative to the characteristic length or in rad, at the end
    error        of a run with the defaults, the largest, the same way; and how many times the uncertainty that is
    cause        why it ended
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from liegroup_core import Simulation, SimulationError, load_scene
from liegroup_core.reference import Reference, Trajectory, distance
from liegroup_core.scene.load import scene_from_text

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "test"))  # random mechanisms

from random_mechanisms import random_mechanism  # noqa: E402

STIFF = """
name: stiff_spring
gravity: [0, 0, -9.81]
bodies:
  - {name: a, shape: {type: rod, axis: [1, 0, 0], length: 1, radius: 0.02, mass: 1, position: [0.5, 0, 0]}}
  - {name: b, shape: {type: sphere, radius: 0.05, mass: 0.5}, position: [1.2, 0, 0]}
joints:
  - {name: hinge, type: revolute, parent: world, child: a, parent_frame: {axis: [0, 1, 0]},
     child_frame: {axis: [0, 1, 0]}}
forces:
  - {name: spring, type: spring_damper, parent: a, child: b, parent_point: [1, 0, 0], child_point: [0, 0, 0],
     stiffness: 1.0e6, damping: 500, rest_length: 0.2}
"""
SPATIAL = """
name: spatial_four_bar
gravity: [0, 0, -9.81]
assemble: true
bodies:
  - {name: crank, shape: {type: rod, axis: [1, 0, 0], length: 0.3, radius: 0.02, mass: 0.5, position: [0.15, 0, 0]},
     position: [0, 0, 0], initial: fixed}
  - {name: coupler, shape: {type: rod, axis: [1, 0, 0], length: 1.2, radius: 0.02, mass: 1, position: [0.6, 0, 0]},
     position: [0.3, 0, 0], rotation_vector: [0, -0.5, 0.8]}
  - {name: rocker, shape: {type: rod, axis: [0, 0, 1], length: 0.8, radius: 0.02, mass: 1, position: [0, 0, 0.4]},
     position: [0.8, 1.0, 0]}
joints:
  - {name: pin, type: revolute, parent: world, child: crank, child_frame: {}, rate: 6}
  - {name: near, type: spherical, parent: crank, child: coupler, parent_frame: {position: [0.3, 0, 0]}, child_frame: {}}
  - {name: far, type: universal, parent: rocker, child: coupler, parent_frame: {position: [0, 0, 0.8]},
     child_frame: {position: [1.2, 0, 0], axis: [0, 1, 0]}}
  - {name: post, type: revolute, parent: world, child: rocker, parent_frame: {position: [0.8, 1, 0], axis: [1, 0, 0]},
     child_frame: {axis: [1, 0, 0]}}
"""
OTHERS = {
    "random loops": lambda: random_mechanism("planar loops", 3)[0],
    "stiff spring": lambda: scene_from_text(STIFF),
    "spatial four-bar": lambda: scene_from_text(SPATIAL),
}
EXAMPLES = sorted(path.stem for path in (ROOT / "config" / "scenes").glob("*.yaml"))
SAMPLES = 50  # between two looks at the clock


def figures(scene, seconds, cpu):
    """(time reached, CPU s, uncertainty, error, cause)."""
    simulation = Simulation(scene)
    state, length = simulation.state(), simulation.layout.size
    Reference(simulation.scene, *state).up_to_limit(np.array([1e-4]))  # compiles
    reference = Reference(simulation.scene, *state, end=seconds)
    steps = np.unique(np.round(np.linspace(0.0, seconds / simulation.step, 20 * SAMPLES + 1)).astype(int))
    reached, spent, cause, uncertainty, error = 0.0, 0.0, None, 0.0, 0.0
    for block in np.array_split(steps[1:], 20):
        began = time.process_time()
        exact, apart = reference.up_to_limit(block * simulation.step)
        spent, cause = spent + time.process_time() - began, reference.stopped
        for k in range(len(exact.times)):
            simulation.advance(int(block[k]) - simulation.steps)
            sample = simulation.sample()
            n = len(sample.pose)
            found = Trajectory(None, sample.pose[:, :9].reshape(n, 3, 3), sample.pose[:, 9:], sample.twist)
            off = distance(
                Trajectory(None, *(np.asarray(part)[None] for part in found[1:])),
                Trajectory(None, *(part[k : k + 1] for part in exact[1:])),
            )
            error = max(error, off.position.max() / length, off.angle.max())
            uncertainty = max(apart.position[k].max() / length, apart.angle[k].max())
            reached = float(exact.times[k])
        if cause or spent > cpu:
            break
    return reached, spent, uncertainty, error, cause or ("" if reached >= seconds * 0.999 else "its CPU time")


def main():
    """Print a line for each mechanism."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--cpu", type=float, default=600.0, help="CPU time of a reference, s")
    parser.add_argument("--only", nargs="+", default=[*EXAMPLES, *OTHERS], metavar="NAME")
    given = parser.parse_args()
    print(f"{'':20}{'reached':>9}{'CPU':>9}{'uncertainty':>13}{'error':>10}{'ratio':>10}  cause")
    for name in given.only:
        try:
            scene = OTHERS[name]() if name in OTHERS else load_scene(name)
            reached, spent, uncertainty, error, cause = figures(scene, given.seconds, given.cpu)
        except SimulationError as failure:
            print(f"{name:20}{failure}", flush=True)
            continue
        cost, ratio = spent / max(reached, 1e-9), error / max(uncertainty, 1e-16)
        print(f"{name:20}{reached:9.4g}{cost:9.2g}{uncertainty:13.1e}{error:10.1e}{ratio:10.1g}  {cause}", flush=True)


if __name__ == "__main__":
    main()
