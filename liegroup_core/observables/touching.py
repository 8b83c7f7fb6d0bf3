# SPDX-License-Identifier: Apache-2.0
"""What contacts do, and what they exert on their bodies, and where: from their laws (forces/contact.py)."""

import numpy as np

from liegroup_core.events.switching import LEAVE, SLIDE, STICK, TOUCH
from liegroup_core.forces.formulas import ABOVE, AND, BELOW, LESS, LESS_EQUAL, OPEN
from liegroup_core.forces.law import registers_of
from liegroup_core.forces.skipping import instructions
from liegroup_core.lie.groups import cross

APART, STICKS, SLIPS = range(3)  # modes of a contact
NEVER = np.nan  # a branch that no kink has


class Touching:
    """Points of the contacts of a Layout.

    names  : of the contacts, in the order of the scene
    bodies : (c,) numbers of the bodies on which they act
    count  : m, of their points
    """

    def __init__(self, layout):
        described, laws = layout.centred.forces, layout.model.forces.laws
        self.names = tuple(force.name for force in described if force.type == "contact")
        self._com = layout.offsets.com
        signals = registers_of(described)
        rows, points = iter(laws.outputs), []
        for force in (each for each in described if hasattr(each, "as_law")):
            own = [next(rows) for each in force.as_law.outputs if each.servo is None]
            for k, *names in force.points if force.type == "contact" else ():
                register = lambda each, law=force.name: signals.get((law, each), -1)  # noqa: E731
                *conditions, arm = names
                numbers = [each if register(each) < 0 else 0.0 for each in arm]
                conditions = [register(each) for each in conditions]
                points.append((force.name, own[k], conditions, [register(each) for each in arm], numbers))
        self.count = len(points)
        owners, rows, conditions, arms, numbers = zip(*points) if points else ((),) * 5
        own = [owner == name for name in self.names for owner in owners]
        self._of = np.array(own, dtype=float).reshape(len(self.names), len(owners))
        self._bodies = np.array([row["body"] for row in rows], dtype=int)
        self._points = np.array([row["point"] for row in rows], dtype=float).reshape(-1, 3)
        self._registers = np.array([row["registers"] for row in rows], dtype=int).reshape(-1, 6)
        self._conditions = np.array(conditions, dtype=int).reshape(-1, 2)
        self._normals, self._arms = self._conditions[:, 0], np.array(arms, dtype=int).reshape(-1, 3)
        self._numbers = np.array(numbers, dtype=float).reshape(-1, 3)
        self.bodies = self._bodies[self._of.argmax(axis=1)] if self.names else self._bodies
        # Both are `... if near and depth > 0 and damping*leaving < 1 else 0`: the kinks of the comparisons.
        writes = {row[1]: row for row in instructions(laws.code.tolist())}
        kinks = {int(laws.code[i, 4]): k for k, i in enumerate(laws.kinks[:, 0])}

        def all_of(register):
            operation, _, a, b, c = writes[register]
            if operation == AND:
                return [*all_of(a), *all_of(b)]
            return [(kinks[c], BELOW if operation in (LESS, LESS_EQUAL) else ABOVE)]

        found = [all_of(writes[at][2]) if at >= 0 else [(0, NEVER)] for at in self._conditions.ravel().tolist()]
        most = max(map(len, found), default=1)
        pairs = np.reshape([each + each[:1] * (most - len(each)) for each in found], (-1, 2, most, 2))
        self._kinks, self._sides = pairs[..., 0].astype(int), pairs[..., 1]

    def points(self, branches, before=False):
        """(m, 2) whether each point of a contact presses, and whether it would slip then.

        branches : (q,) of the kinks of laws;  before : the result as it was, where a branch is open
        """
        found = branches[self._kinks]
        return np.where((found == OPEN).any(axis=-1), before, (found == self._sides).all(axis=-1))

    def modes(self, points):
        """(c,) APART; STICKS: a point that presses sticks; SLIPS: all points that press slip.  points : (m, 2)."""
        presses, slips = points.T
        return (self._of @ presses > 0.0) * (SLIPS - (self._of @ (presses & ~slips) > 0.0))

    def changes(self, before, points):
        """[(number of a contact, TOUCH, LEAVE, SLIDE or STICK)] of those whose modes change with their points."""
        found = []
        if (before == points).all():
            return found
        for c, (was, now) in enumerate(zip(self.modes(before), self.modes(points))):
            if (was == APART) != (now == APART):
                found.append((c, LEAVE if now == APART else TOUCH))
            if now != APART and (was == SLIPS) != (now == SLIPS):
                found.append((c, SLIDE if now == SLIPS else STICK))
        return found

    def _places(self, registers, pose):
        """(m, 3) from the frames to where outputs act, and (m, 3) the points; m, world axes. Arguments as of `at`."""
        own = pose[self._bodies]
        starts = (own[:, :9].reshape(-1, 3, 3) @ self._points[:, :, None])[..., 0]
        return starts, own[:, 9:] + starts + np.where(self._arms < 0, self._numbers, registers[self._arms, 0])

    def pressing(self, registers, pose):
        """(m, 5) of each point: whether it presses, x, y, z in m, world axes, and if it slips, as without friction.

        Arguments as of `at`.
        """
        presses, yields = np.where(self._conditions < 0, 1.0, registers[self._conditions, 0]).T
        return np.column_stack([presses > 0.0, self._places(registers, pose)[1], yields > 0.0])

    def at(self, registers, pose):
        """(c, 9) per contact: centre of pressure, world axes, or NaN; torque and force on the body, as Sample.

        registers : (m, 2) of the laws, computed;  pose : (n, 12) of the frames at the centres of mass
        """
        values, (starts, places) = registers[:, 0], self._places(registers, pose)
        torques, forces = values[self._registers[:, :3]], values[self._registers[:, 3:]]
        weights = self._of * values[self._normals]
        with np.errstate(invalid="ignore"):
            centres = weights @ places / weights.sum(axis=1, keepdims=True)
        turns = pose[self.bodies, :9].reshape(-1, 3, 3)
        torque, force = (
            ((self._of @ each)[:, None] @ turns)[:, 0] for each in (torques + cross(starts, forces), forces)
        )
        return np.hstack([centres, torque + cross(self._com[self.bodies], force), force])
