# SPDX-License-Identifier: Apache-2.0
"""Cost of linear systems: of `linearise`, of the tangents alone, and of an evaluation, with growth in size.

    python benchmarks/linear.py

Tangents: derivatives of all accelerations with respect to all coordinates and rates, in machine code, from the
difference of calls with these directions once and 21 times. Evaluation: a stage of the method rkmk4. With Pinocchio
installed (pip install pin example-robot-data) also its computeABADerivatives of the same chains and robots, which is
C++. Medians of runs.

Then sensitivities of a run of 1 s to the masses of all bodies, beside six runs for each of them, which differences
of order six take.
"""

import statistics
import time
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from liegroup_core import Simulation
from liegroup_core.linear import linearise, sensitivities
from liegroup_core.linear.probe import Probe
from liegroup_core.scene.library import chain, four_bar_windows
from liegroup_core.scene.load import load_scene

SECONDS = 0.5  # for each figure


def median(call):
    """Median time of a call in us."""
    call()
    times, end = [], time.perf_counter() + SECONDS
    while time.perf_counter() < end or len(times) < 3:
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return 1e6 * statistics.median(times)


def chain_of_peer(links):
    """Pinocchio's model of a chain of hinges."""
    import pinocchio as pin

    model, joint = pin.Model(), 0
    for k in range(links):
        place = pin.SE3(np.eye(3), np.array([0.1 if k else 0.0, 0.0, 0.0]))
        joint = model.addJoint(joint, pin.JointModelRY(), place, f"j{k}")
        model.appendBodyToJoint(joint, pin.Inertia(0.1, np.array([0.05, 0, 0]), 1e-4 * np.eye(3)), pin.SE3.Identity())
    return model


def pinocchio_us(model):
    """Time of computeABADerivatives, us."""
    import pinocchio as pin

    data, rng = model.createData(), np.random.default_rng(0)
    q, v, tau = pin.neutral(model), rng.normal(size=model.nv), rng.normal(size=model.nv)
    return median(lambda: pin.computeABADerivatives(model, data, q, v, tau))


def tangents_us(probe):
    """Time of the tangents along all coordinates and rates of the tree, us."""
    f = probe.freedoms
    directions = np.eye(2 * f).reshape(2 * f, 2, f).swapaxes(1, 2)
    many = np.concatenate(21 * [directions])
    calls = [
        lambda each=each, sizes=np.full(len(each), 1e-2): probe.tangents(each, sizes) for each in (directions, many)
    ]
    once, often = map(median, calls)
    return (often - once) / 20.0


def robots():
    """URDF files of an arm with six hinges, one with seven, and a humanoid with 32, as far as they are installed."""
    spec = find_spec("cmeel")
    if spec is None:
        return []
    folder = Path(spec.origin).parents[1] / "cmeel.prefix" / "share" / "example-robot-data" / "robots"
    names = ("ur_description/urdf/ur5_robot", "panda_description/urdf/panda", "talos_data/robots/talos_reduced")
    return [path for path in (folder / f"{name}.urdf" for name in names) if path.is_file()]


def row(name, scene, peer=None):
    simulation = Simulation(scene, "rkmk4", 1e-5, estimate=False, quiet=True)
    probe = Probe(simulation)
    evaluation = median(lambda: simulation.advance(50)) / 200.0
    system, tangents = linearise(simulation), tangents_us(probe)
    whole = median(lambda: linearise(simulation))
    other = pinocchio_us(peer) if peer is not None else float("nan")
    print(
        f"{name:<22} {len(system.A):6d} {evaluation:11.2f} {tangents:12.1f} {tangents / evaluation:12.1f} "
        f"{whole / 1e3:10.2f} {other:14.1f} {tangents / other:7.1f}"
    )


def run_row(name, scene):
    """Print the cost of the sensitivities of a run, and that of runs for differences, in s."""
    key = [f"bodies.{body.name}.{'shape.' if body.shape else ''}mass" for body in scene.bodies]
    times = np.linspace(0.05, 1.0, 20)

    def one_run():
        for _ in Simulation(scene, accuracy=1e-12, quiet=True).samples(times):
            pass

    found, run = median(lambda: sensitivities(scene, key, times)), median(one_run)
    print(f"{name:<22} {len(key):7d} {found / 1e6:18.2f} {6 * len(key) * run / 1e6:8.2f}")


def main():
    """Print the tables."""
    peer = find_spec("pinocchio") is not None
    print("mechanism              states  evaluation  tangents, us  evaluations  whole, ms  Pinocchio, us   ratio")
    for links in (2, 5, 10, 20, 40):
        row(f"{links} hinges", chain(links, "revolute"), chain_of_peer(links) if peer else None)
    for path in robots() if peer else ():
        import pinocchio as pin

        joint = pin.JointModelFreeFlyer() if "talos" in path.name else None
        arguments = (str(path), joint) if joint else (str(path),)
        row(path.stem, load_scene(str(path)), pin.buildModelFromUrdf(*arguments))
    for windows in (1, 5, 20):
        row(f"{windows} four-bar windows", four_bar_windows(windows))
    for name in ("bicycle", "flyball_governor", "andrews_squeezer"):
        row(name, load_scene(name))
    print("\nmechanism              numbers   sensitivities, s  runs, s")
    for name in ("heavy_top", "double_pendulum", "four_bar", "hinge_chain", "door"):
        run_row(name, load_scene(name))


if __name__ == "__main__":
    main()
