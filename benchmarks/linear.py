# SPDX-License-Identifier: Apache-2.0
"""Cost of linear systems: time of `linearise`, of its derivatives alone, and of an evaluation, with growth in size.

    python benchmarks/linear.py

With Pinocchio installed (pip install pin) also its computeABADerivatives on the same chains. Medians of runs.
"""

import statistics
import time
from importlib.util import find_spec

import numpy as np

from liegroup_core import Simulation
from liegroup_core.linear import linearise
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


def pinocchio_us(links):
    """Time of computeABADerivatives for a chain of hinges, us; nan without Pinocchio."""
    if find_spec("pinocchio") is None:
        return float("nan")
    import pinocchio as pin

    model, joint = pin.Model(), 0
    for k in range(links):
        place = pin.SE3(np.eye(3), np.array([0.1 if k else 0.0, 0.0, 0.0]))
        joint = model.addJoint(joint, pin.JointModelRY(), place, f"j{k}")
        model.appendBodyToJoint(joint, pin.Inertia(0.1, np.array([0.05, 0, 0]), 1e-4 * np.eye(3)), pin.SE3.Identity())
    data, rng = model.createData(), np.random.default_rng(0)
    q, v, tau = rng.normal(size=(3, links))
    return median(lambda: pin.computeABADerivatives(model, data, q, v, tau))


def row(name, scene, links=0):
    simulation = Simulation(scene, "rkmk4", 1e-3, estimate=False, quiet=True)
    probe = Probe(simulation)
    evaluation = median(probe.slopes)
    system = linearise(simulation)
    whole, states = median(lambda: linearise(simulation)), median(lambda: linearise(simulation, [], []))
    peer = pinocchio_us(links) if links else float("nan")
    print(
        f"{name:<22} {len(system.A):6d} {evaluation:11.1f} {states / 1e3:12.2f} {whole / 1e3:12.2f} "
        f"{states / evaluation / max(1, len(system.A)):18.1f} {peer:12.1f}"
    )


def main():
    """Print the table."""
    print("mechanism              states  evaluation   A only, ms    whole, ms  evaluations/state  Pinocchio, us")
    for links in (2, 5, 10, 20, 40):
        row(f"{links} hinges", chain(links, "revolute"), links)
    for windows in (1, 5, 20):
        row(f"{windows} four-bar windows", four_bar_windows(windows))
    for name in ("bicycle", "flyball_governor", "andrews_squeezer"):
        row(name, load_scene(name))


if __name__ == "__main__":
    main()
