# SPDX-License-Identifier: Apache-2.0
"""Comparison of three symmetric rotation updates for constrained RATTLE.

    python benchmarks/turns.py [--steps 50000]

In `constrained_rattle` the rotation x of a body in a step determines its velocity w' at the start,
y = h I w'. This update is replaced by others that are symmetric and of order 2:
    variational      y = dexpinv_{-x} I x                               the method itself
    Lie midpoint     y = exp(x/2) I x                                   not variational
    Moser-Veselov    y = (sin t/t) I x + ((1-cos t)/t^2) x x I x        variational, t = |x|
Prints for a chain of three ball joints that swings chaotically
    error    of the poses after 1 s, rad or m, against the independent integration
    scatter  rms of the energy about its mean over a long run, and largest deviation from the
             start, both relative to the largest kinetic energy
Each update is compiled in a cache of its own, which takes some minutes.
"""

import argparse
import os
import subprocess
import sys
import tempfile

import numpy as np

from liegroup_core.engine import Engine

TURNS = ("variational", "Lie midpoint", "Moser-Veselov")
STEP = 4e-3  # s
SHORT = (4e-3, 2e-3, 1e-3)  # s, steps for the error
SAMPLES = 2000


def put(turn):
    """Replace the rotation update of the method; call it before anything is compiled."""
    from liegroup_core.compiling import kernel
    from liegroup_core.lie.coefficients import turn_coefficients
    from liegroup_core.lie.so3 import so3_exp
    from liegroup_core.lie.vec3 import axpy3, cross3, dot3, matvec3, scale3
    from liegroup_core.methods.rattle import space_links

    # In place of dexpinv_{-x}, with its arguments.
    @kernel
    def midpoint(first, factor, x, y):
        return matvec3(so3_exp(scale3(0.5, x)), y)

    @kernel
    def moser_veselov(first, factor, x, y):
        sinc, versinc = turn_coefficients(dot3(x, x))
        return axpy3(versinc, cross3(x, y), scale3(sinc, y))

    if turn != TURNS[0]:
        space_links.so3_dexpinv_of = midpoint if turn == TURNS[1] else moser_veselov


def chain():
    """Three bodies on spherical joints, released sideways, the last one spinning."""
    from liegroup_core import Scene
    from liegroup_core.scene.description import Body, Frame, Joint

    names = ("a", "b", "c")
    return Scene(
        name="chain",
        gravity=(0.0, 0.0, -9.81),
        bodies=[
            Body(
                name=name,
                mass=1.0,
                inertia=(0.02, 0.05, 0.06),
                position=(k + 0.5, 0.1, 0.0),
                angular_velocity=(8.0 if name == "c" else 0.0, 0.0, 0.0),
            )
            for k, name in enumerate(names)
        ],
        joints=[
            Joint(
                name=f"ball_{name}",
                type="spherical",
                parent=before,
                child=name,
                parent_frame=Frame(position=(0.0, 0.1, 0.0) if k == 0 else (0.5, 0.0, 0.0)),
                child_frame=Frame(position=(-0.5, 0.0, 0.0)),
            )
            for k, (before, name) in enumerate(zip(("world", *names), names))
        ],
    )


def measure(steps):
    """Print errors and energies of the active rotation update."""
    from liegroup_core.reference import integrate

    scene = chain()
    start = Engine(scene, method="constrained_rattle").state()
    reference, _ = integrate(scene, *start, [1.0])
    errors = []
    for step in SHORT:
        simulation = Engine(scene, method="constrained_rattle", step=step)
        simulation.advance(round(1.0 / step))
        pose = simulation.state()[0]
        errors.append(
            max(
                np.abs(pose[:, :9] - reference.rotation[0].reshape(-1, 9)).max(),
                np.abs(pose[:, 9:] - reference.position[0]).max(),
            )
        )
    simulation = Engine(scene, method="constrained_rattle", step=STEP)
    first, energy, kinetic = simulation.energy(), [], []
    for k in range(SAMPLES):
        simulation.advance(steps // SAMPLES)
        sample = simulation.sample()
        energy.append(sample.energy - first)
        kinetic.append(sample.energy - 9.81 * sample.pose[:, 11].sum())  # of 1 kg each
    size = max(kinetic)
    energy = np.array(energy) / size
    print(*(f"{error:.2e}" for error in errors), f"{energy.std():.2e}", f"{np.abs(energy).max():.2e}")


def main():
    """Measure each rotation update in its own process and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=50_000)
    parser.add_argument("--turn", choices=TURNS, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.turn:
        put(options.turn)
        measure(options.steps)
        return
    print(
        "turn             error at",
        *(f"{step:g} s" for step in SHORT),
        f"scatter and largest deviation at {STEP:g} s, {options.steps} steps",
    )
    for turn in TURNS:
        with tempfile.TemporaryDirectory() as folder:
            found = subprocess.run(
                [sys.executable, __file__, "--turn", turn, "--steps", str(options.steps)],
                env={**os.environ, "LIEGROUP_CACHE_DIR": folder},
                check=True,
                text=True,
                stdout=subprocess.PIPE,
            ).stdout
        print(f"{turn:16} {found.strip()}", flush=True)


if __name__ == "__main__":
    main()
