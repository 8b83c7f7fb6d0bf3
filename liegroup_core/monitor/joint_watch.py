# SPDX-License-Identifier: Apache-2.0
"""Watch over the joints of a run: whether they stay closed well enough to be believed.

Without stabilisation joints open slowly, by the errors of integration. Next to a singular pose,
where rows are nearly dependent, what they are open by grows a thousand times within a few steps,
and the motion may go on along another branch with residuals that still look small. So it is the
sudden growth that counts, besides the size.
"""

import numpy as np

from liegroup_core.forces.schedule import NEVER
from liegroup_core.formulations.absolute.constraints import position_residuals
from liegroup_core.joints.elements import WORLD

EVERY = 500  # steps from one look at the joints to the next: some 20 us each
# Of the mechanism's size: joints open by more are no joints any more.
OPEN = 1e-3
# Growth between two looks that integration errors do not have, and what is too small to matter.
SUDDEN, TOO_SMALL = 100.0, 1e-8


def mechanism_size(model):
    """Length that gaps of joints are compared with, m: from joints and rims to centres of mass."""
    bodies, elements = model.bodies, model.elements
    gyration = np.sqrt(bodies["inertia"][:, [0, 4, 8]].sum(axis=1) / bodies["mass"])
    arms = [
        np.linalg.norm(elements[f"{end}_point"][elements[end] != WORLD], axis=1).max(initial=0.0)
        for end in ("parent", "child")
    ]
    return float(max(gyration.max(), *arms))


class JointWatch:
    """Looks at the joints of a layout on the way; says what is wrong, each kind once."""

    def __init__(self, layout):
        self._layout = layout
        self._scale = None  # no joints, or joints that are closed every step
        if len(layout.model.elements) and not layout.model.projects:
            size = mechanism_size(layout.model)
            self._scale = np.array(
                [
                    1.0 if name.startswith("w") else 1.0 / size
                    for names in layout.row_names
                    for name in names
                ]
            )
            self._residual = np.zeros(len(self._scale))
        self.restart()

    def restart(self):
        """Another state."""
        self._said = set()
        self.pushed()

    def pushed(self):
        """Other wrenches: what the joints did before does not count."""
        self._largest = None

    def next_look(self, steps):
        """The step after this one at which to look, whichever way the steps are asked for."""
        return NEVER if self._scale is None else (steps // EVERY + 1) * EVERY

    def look(self, pose, steps, time, at_once=False, between=False):
        """Look at a pose (n, 12) of the model; returns a line of text, or None if all is well.

        at_once : also between the steps at which it is time to
        between : then too, but only for joints that are open, as growth is from one time to the next
        """
        if self._scale is None or steps % EVERY and not (at_once or between):
            return None
        pose = pose.view()
        pose.flags.writeable = False  # as in a Sample: one compiled function serves both
        position_residuals(self._layout.model, pose, self._residual)
        gaps = np.abs(self._residual) * self._scale
        worst = int(gaps.argmax())
        gap, before = float(gaps[worst]), self._largest
        if at_once or not steps % EVERY:
            self._largest = gap if before is None else max(gap, before)
        else:
            before = None
        joint = self._layout.scene.joints[self._layout.joint_of_row[worst]].name
        if gap > OPEN and "open" not in self._said:
            self._said.add("open")
            return (
                f"joint {joint} is open by {gap:.3g} of the mechanism's size at t = "
                f"{time:.6g} s: this is its motion no more; use stabilisation projection or a "
                "smaller step"
            )
        sudden = before is not None and gap > max(SUDDEN * before, TOO_SMALL)
        if sudden and "sudden" not in self._said:
            self._said.add("sudden")
            return (
                f"joint {joint} opened suddenly, from {before:.3g} to {gap:.3g} of the "
                f"mechanism's size shortly before t = {time:.6g} s, as at a singular pose or "
                "in a motion too fast for the step: from there on the motion may be another "
                "one; use stabilisation projection or a smaller step"
            )
        return None
