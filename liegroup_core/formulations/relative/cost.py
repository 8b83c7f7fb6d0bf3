# SPDX-License-Identifier: Apache-2.0
"""Predicted cost of a stage of a Munthe-Kaas method, in relative coordinates and on SE(3)^n.

The coefficients are fitted to rkmk4, in ns of a core of 3 GHz. Of scenes and problems without forces
(benchmarks/predicted_cost.py) most predictions are within 20 % of the measured costs. The worst, SE(3)^n
with many loops in space, is 42 % low. Forces are left out. In relative coordinates they cost more: the
first one also the poses of the links in the world.
"""

import numpy as np

from liegroup_core.model.sparsity import operations

from .arrays import FREE, PLANE, PlaneModel

# ns of a link by its motion group, in the order of the codes in arrays.py.
LINK_COSTS = np.array([90.0, 80.0, 135.0, 112.0, 108.0, 142.0, 205.0])
PLACED_LINK = 70.0  # ns of a link where joints are cut: poses in the world
RESPONSE = 10.0  # ns of a row and a link on its path
PRODUCT = 0.7  # ns of an addend of W
FACTOR = 0.4  # ns of a product in the factorisation of W
# The same in a plane: hinges and slides, a plate; from rows of windows.
PLANE_LINK_COST, PLATE, PLANE_PLACED, PLANE_RESPONSE, PLANE_PRODUCT = 50.0, 65.0, 8.0, 5.0, 1.0
# Below this ratio of predicted costs relative coordinates are chosen: their joints cannot open, and
# with floating parts the prediction for them is up to 30 % too high.
PREFERRED = 1.25
BODY, JOINT, OPERATION = 65.0, 64.0, 0.25  # ns on SE(3)^n


def relative_cost(relative):
    """Predicted ns of a stage in relative coordinates; relative: RelativeModel."""
    group = relative.bodies["group"]
    cost, placed, response, product = LINK_COSTS[group].sum(), PLACED_LINK, RESPONSE, PRODUCT
    if isinstance(relative, PlaneModel):
        cost = np.where(group == PLANE, PLATE, PLANE_LINK_COST).sum()
        placed, response, product = PLANE_PLACED, PLANE_RESPONSE, PLANE_PRODUCT
    if len(relative.joints) == 0:
        return float(cost)
    rows, own = relative.joints["rows"], np.diff(relative.path_ends)
    cost += placed * len(relative.bodies)
    cost += response * ((relative.paths[:, 1] - relative.paths[:, 0]) * rows).sum()
    i, j, end = relative.shared.T
    cost += product * (own * rows**2).sum()
    cost += product * (np.diff(end, prepend=0) * rows[i] * rows[j]).sum()
    width = np.arange(len(relative.first_column)) - relative.first_column
    return float(cost + FACTOR * (width**2).sum())


def absolute_cost(model):
    """Predicted ns of a stage on SE(3)^n; model: Model."""
    factor, solve = operations(model.vertices, model.columns, model.updates)
    solve *= 1 + model.refinements
    return BODY * len(model.bodies) + JOINT * len(model.joints) + OPERATION * (factor + solve)


def has_fewer_unknowns(relative):
    """True if implicit steps solve for fewer unknowns than on SE(3)^n; relative: RelativeModel.

    They take dense factors. With one joint among 16 free bodies they are faster in relative
    coordinates, without any joint on SE(3)^n.
    """
    return _saved(relative) > 0


def saves_sweeps(relative):
    """True if a RATTLE step costs less in relative coordinates; relative: RelativeModel.

    A floating link saves no unknowns, and its coordinates cost as much as eight of them: found with
    random mechanisms of which half or more of the links float. All others are faster.
    """
    return _saved(relative) > 8 * (relative.bodies["group"] == FREE).sum()


def _saved(relative):
    """Number of unknowns that relative coordinates save."""
    space = relative.space
    unknowns = int(relative.bodies["freedoms"].sum()) + len(relative.row_residual)
    return 6 * len(space.bodies) + len(space.row_residual) - unknowns


def is_cheaper(relative):
    """True if relative coordinates cost less than SE(3)^n, or hardly more; relative: RelativeModel."""
    return relative_cost(relative) < PREFERRED * absolute_cost(relative.space)
