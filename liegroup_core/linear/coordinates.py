# SPDX-License-Identifier: Apache-2.0
"""Independent coordinates of a mechanism near a state, and the tangent space of its motions.

Without loops every degree of freedom of the spanning tree is independent. Cut joints, couplings and driven
joints leave a subspace, the range of the projection of velocities P. Rows of a basis N of it with the best
condition are independent coordinates z:

    psi = N z ,   w = N z' + c(z)

with the changes c of dependent rates that keep the joints closed where the position changes. Together they are
the tangent space of all states, in which the equations of motion are linearised.
"""

from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy

from liegroup_core.errors import SceneError
from liegroup_core.fields.values import suggestion
from liegroup_core.mechanism.arrays import OWN
from liegroup_core.mechanism.links import find_links
from liegroup_core.mechanism.mechanism import tree_of
from liegroup_core.scene.consistency import resolve_frames

from .differences import derivative

COMPONENTS = ("rx", "ry", "rz", "x", "y", "z")
ANGLE, SHARE = 1e-2, 1e-2  # first displacement: rad, and of the mechanism's size


class Freedom(NamedTuple):
    """A degree of freedom of the spanning tree.

    name : of its joint with one coordinate, else JOINT.COMPONENT or BODY.COMPONENT
    unit : "rad" or "m"
    sign : of its coordinate when that of the joint increases
    """

    name: str
    unit: str
    sign: float


def freedoms_of(layout):
    """[Freedom] of the spanning tree, in the order of all arrays.

    Components of other joints are a rotation vector rx, ry, rz and a shift x, y, z in the frame of the link.
    """
    scene = layout.centred
    links, _ = find_links(scene, resolve_frames(scene), tree_of(scene), layout.normal)
    found = []
    for link in links:
        if link.joint is None:
            name = next(iter(link.bodies))
        else:
            name = scene.joints[link.joint].name
        if link.coordinates != OWN:
            found.append(Freedom(f"{name}.{'12'[sum(f.name.startswith(name + '.') for f in found)]}", "rad", 1.0))
            continue
        one = link.joint is not None and len(link.components) == 1
        for component in link.components:
            label = name if one else f"{name}.{COMPONENTS[component]}"
            found.append(Freedom(label, "rad" if component < 3 else "m", link.sign if one else 1.0))
    return found


class Coordinates:
    """Independent coordinates near the state of a Probe.

    chosen : names of freedoms that are independent; None: those with the best condition

    freedoms : [Freedom]
    independent : indices of the independent ones
    motions  : N (f, m), unit rows at the independent ones
    names, units : of the independent coordinates
    Raises SceneError for unknown or dependent names.
    """

    def __init__(self, probe, chosen=None):
        self._probe, self.freedoms = probe, freedoms_of(probe.layout)
        self._signs = np.array([freedom.sign for freedom in self.freedoms])
        length = probe.layout.size
        self._units = np.array([1.0 if freedom.unit == "rad" else length for freedom in self.freedoms])
        self.independent, self.motions = self._basis(chosen)
        self.names = [self.freedoms[k].name for k in self.independent]
        self.units = [self.freedoms[k].unit for k in self.independent]

    @property
    def signs(self):
        """(m,) signs of the independent coordinates in their joints."""
        return self._signs[self.independent]

    def size(self, k):
        """First displacement along independent coordinate k."""
        return ANGLE if self.units[k] == "rad" else SHARE * self._probe.layout.size

    def _basis(self, chosen):
        probe = self._probe
        f = probe.freedoms
        free = np.flatnonzero(~probe.held)
        if probe.is_closed:
            # Columns of P in the units of the freedoms; its nonzero singular values are at least 1.
            rest = probe.closed()[0]
            rows = []
            for k in free:
                y = np.zeros((f, 2))
                y[k, 1] = self._units[k]
                rows.append((probe.closed(y)[0] - rest) / self._units)
            left, sizes, _ = np.linalg.svd(np.array(rows).reshape(-1, f).T, full_matrices=False)
            basis = left[:, sizes > 0.5]
        else:
            basis = np.eye(f)[:, free]
        count = basis.shape[1]
        if chosen is None:
            picked = np.sort(scipy.linalg.qr(basis.T, pivoting=True, mode="r")[1][:count])
        else:
            picked = np.array([self.number(name) for name in chosen], dtype=int)
            if len(set(picked.tolist())) != count:
                raise SceneError(f"{len(picked)} independent coordinates are given, the mechanism has {count} here")
        square = basis[picked]
        if count and np.linalg.svd(square, compute_uv=False)[-1] < 1e-9:
            raise SceneError(f"the coordinates {', '.join(self.freedoms[k].name for k in picked)} are not independent")
        motions = self._units[:, None] * np.linalg.solve(square.T, basis.T).T / self._units[picked]
        motions[picked] = np.eye(count)
        return picked, motions

    def number(self, name):
        """Index of the freedom with a name. Raises SceneError."""
        names = [freedom.name for freedom in self.freedoms]
        if name not in names:
            raise SceneError(f"unknown coordinate {name!r}; {suggestion(name, names)}")
        return names.index(name)

    @cached_property
    def changes(self):
        """Changes c (f, m) of the dependent rates with the coordinates; zero without loops."""
        probe = self._probe
        changes = np.zeros_like(self.motions)
        if not probe.is_closed:
            return changes
        for k in range(len(self.independent)):
            y = np.zeros((probe.freedoms, 2))

            def rates(s, direction=self.motions[:, k], y=y):
                y[:, 0] = s * direction
                return probe.closed(y)[0]

            change, _ = derivative(rates, self.size(k))
            changes[:, k] = change - self.motions @ change[self.independent]
        return changes

    def neighbour(self, k, s, rate=False):
        """y (f, 2) a distance s along independent coordinate k, or along its rate; for a derivative."""
        y = np.zeros((self._probe.freedoms, 2))
        if rate:
            y[:, 1] = s * self.motions[:, k]
        else:
            y[:, 0], y[:, 1] = s * self.motions[:, k], s * self.changes[:, k]
        return y

    def at(self, z):
        """y (f, 2) of independent coordinates z (m,) at the rates of the state: before projection."""
        y = np.zeros((self._probe.freedoms, 2))
        y[:, 0] = self.motions @ z
        return y
