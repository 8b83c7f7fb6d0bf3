# SPDX-License-Identifier: Apache-2.0
"""Order of every Munthe-Kaas and RATTLE method in relative coordinates, against an independent reference.

The reference (liegroup_core/reference) shares no code with the engine: poses of all bodies,
multipliers of all joints, SciPy's DOP853 at 1e-13. Slopes are fitted to end poses.
    tree   every group of a joint: SE(2), SO(2)^2, SO(2) x R, SO(3), screw, R, SE(3), SO(2); a branch
    loop   four bodies in space, one of them on a ball; Munthe-Kaas methods project the cut joint
Both have rotations that do not commute.
"""

import mechanisms
import numpy as np
import pytest
from convergence import order_by_count

from liegroup_core import Simulation
from liegroup_core.methods.table import METHODS
from liegroup_core.motion_groups.table import DIRECT, FREEDOMS
from liegroup_core.reference.trajectory import integrate

TIMES = (0.25, 0.5, 0.75)  # s
LINKS = {
    "tree": mechanisms.with_every_pair(
        [
            ("world", "a", "planar"),
            ("a", "b", "universal"),
            ("b", "c", "cylindrical"),
            ("c", "d", "spherical"),
            ("d", "e", "screw"),
            ("b", "f", "prismatic"),
            ("world", "g", None),
            ("g", "h", "revolute"),
        ]
    ),
    "loop": [("world", "a", "revolute"), ("a", "b", "universal"), ("b", "c", "spherical"), ("c", "d", "revolute")],
}
CLOSING = {"tree": [], "loop": [("world", "d", "spherical")]}
FAMILIES = ("rkmk", "constrained")
ON_LINKS = [name for name, method in METHODS.items() if method.family in FAMILIES]
# Which of TIMES, and steps until then to which slopes are fitted, by order.
SMALL = {
    1: (0, (1024, 2048, 4096, 8192)),
    2: (0, (128, 256, 512, 1024)),
    3: (0, (64, 128, 256, 512)),
    4: (0, (64, 96, 128, 192)),
}
STEPS = {
    "tree": SMALL | {5: (0, (64, 96, 128, 192)), 8: (0, (20, 24, 28))},
    "loop": SMALL | {5: (2, (32, 40, 48, 64)), 8: (1, (14, 16, 18, 20, 22))},
}
RATTLE_STEPS = {"tree": SMALL | {8: (0, (14, 16, 20))}, "loop": SMALL | {8: (1, (14, 16, 18, 20, 22))}}


def mechanism(problem):
    """Scene of a problem."""
    links = LINKS[problem]
    return mechanisms.mechanism(np.random.default_rng(3), links, loops=CLOSING[problem])


@pytest.fixture(scope="module")
def references():
    """{problem: (scene, poses at TIMES (3, n, 12), their uncertainties (3,))}."""
    made = {}
    for problem in LINKS:
        scene = mechanism(problem)
        simulation = Simulation(scene, method="rkmk4", step=1e-3, estimate=False)
        motion, uncertainty = integrate(scene, *simulation.state(), TIMES)
        rotations = motion.rotation.reshape(*motion.position.shape[:2], 9)
        poses = np.concatenate([rotations, motion.position], axis=2)
        known = np.maximum(uncertainty.attitude, uncertainty.position).max(axis=1)
        made[problem] = scene, poses, known
    return made


def test_the_tree_has_all_groups():
    model = Simulation(mechanism("tree"), group="relative").layout.relative
    assert set(model.links["group"]) == set(range(len(FREEDOMS))) - {DIRECT}


@pytest.mark.parametrize("problem", LINKS)
@pytest.mark.parametrize("method", ON_LINKS)
@pytest.mark.volume(9)
def test_fitted_order_in_relative_coordinates(references, problem, method):
    """Fitted within 0.2 of the order; the smallest error is above ten times the reference's."""
    scene, exact, uncertainty = references[problem]
    settings = {"rtol": 1e9, "atol": 1e9} if METHODS[method].controlled else {}
    projects = METHODS[method].family == "rkmk"
    steps = STEPS if projects else RATTLE_STEPS
    at, counts = steps[problem][METHODS[method].order]
    found = []
    for count in counts:
        simulation = Simulation(
            scene,
            method=method,
            step=TIMES[at] / count,
            group="relative",
            stabilisation="projection" if projects else "none",
            estimate=False,
            **settings,
        )
        simulation.advance(count)
        found.append(np.abs(simulation.state()[0] - exact[at]).max())
    assert min(found) > 10 * uncertainty[at]
    assert order_by_count(counts, found) == pytest.approx(METHODS[method].order, abs=0.2)
