# SPDX-License-Identifier: Apache-2.0
"""Size of a mechanism: the length that positions and gaps of joints are compared with."""

import numpy as np

from liegroup_core.joints.elements import WORLD


def mechanism_size(model):
    """Largest radius of gyration, or distance from a joint or a rim to a centre of mass, m."""
    bodies, elements = model.bodies, model.elements
    gyration = np.sqrt(bodies["inertia"][:, [0, 4, 8]].sum(axis=1) / bodies["mass"])
    arms = [
        np.linalg.norm(elements[f"{end}_point"][elements[end] != WORLD], axis=1).max(initial=0.0)
        for end in ("parent", "child")
    ]
    return float(max(gyration.max(), *arms))
