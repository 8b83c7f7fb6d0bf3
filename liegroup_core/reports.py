# SPDX-License-Identifier: Apache-2.0
"""Messages of an Engine: warnings, and why it stopped."""

import logging
import math

from liegroup_core.joints.motion import at
from liegroup_core.mechanism.bodies import LARGEST_TURN, SINGULAR_SOLVES, STEP_TURN
from liegroup_core.methods.smaller_step import step_that_works
from liegroup_core.methods.table import METHODS
from liegroup_core.observables.reach import beyond_reach

from .status import (
    BEYOND_STOP,
    DEPENDENT_ROWS,
    LARGE_ROTATION,
    MESSAGES,
    MOST_EVENTS,
    NO_RATTLE_STEP,
    NOT_CONVERGED,
    ROTATION_TOO_LARGE,
    SUBSTEP_TOO_SMALL,
    TOO_MANY_SUBSTEPS,
    TURNS_NOT_COUNTED,
)

log = logging.getLogger("liegroup_core")

# Statuses that fast motion may cause.
FAST = {ROTATION_TOO_LARGE, NOT_CONVERGED, SUBSTEP_TOO_SMALL, TOO_MANY_SUBSTEPS}
# Steps after the last valid one at which a driven joint may be beyond the reach of its loop.
STEPS_AHEAD = (1, 2, 4)


class Reports:
    """Messages of an Engine: its base class. Each warning is given once."""

    def _give_warnings(self):
        if self._work.report[SINGULAR_SOLVES] and not self._warned_singular:
            self._warned_singular = True
            log.warning(
                "Singular configuration before t = %g s: some constraint equations are "
                "redundant there, and the mass distribution decides the remaining motion. %s"
                "If it is always singular, remove a redundant joint",
                self.time,
                ""
                if self.layout.model.projects
                else "If the mechanism only passes this configuration, use stabilisation projection. ",
            )
        if self._switching is not None:
            self._warn_of_events()
        if not self._warned and self._work.report[LARGEST_TURN] > LARGE_ROTATION**2:
            self._warned = True
            turned = math.sqrt(self._work.report[LARGEST_TURN])
            log.warning(
                "%s, step %g s: a body rotated by more than pi within one step (%.3g rad "
                "before t = %g s), so the result is inaccurate. Use a step below %.2g s",
                self.method,
                self.step,
                turned,
                self.time,
                LARGE_ROTATION / turned * self.step,
            )

    def _warn_of_events(self):
        endless, crowded = self._switching.endless, self._switching.crowded
        if endless and not self._warned_endless:
            self._warned_endless = True
            log.warning(
                "At t = %.9g s impacts follow each other without end at %s: they are plastic until the end "
                "of the step, which dissipates energy",
                endless[0],
                self._names_of_switches(endless[1]),
            )
        if crowded and not self._warned_crowded:
            self._warned_crowded = True
            log.warning(
                "At t = %.9g s events follow each other at intervals of %.2g s at %s: each of them is found, "
                "so the run is slow. Widen the gap, reduce the restitution, or use a compliant stop",
                crowded[0],
                crowded[2],
                self._names_of_switches(crowded[1]),
            )

    def _names_of_switches(self, numbers):
        return ", ".join(sorted({self.layout.switches[k].name for k in numbers}))

    def _joint_name(self, element):
        """Name of the scene joint to which an element of the model belongs, or of a coupling."""
        owners = self.layout.owners
        if element >= len(owners):
            return self.scene.couplings[element - len(owners)].name
        return self.scene.joints[owners[element]].name

    def _explain(self, status):
        joint = force = body = hint = ""
        # RATTLE reports the rotation of its step equation, which includes the effect of the torque.
        angle = math.sqrt(self._work.report[STEP_TURN])
        if status & 0xFF == NO_RATTLE_STEP:
            body = self.layout.body_names[status >> 8]
        # No smaller step is suggested if a wrench of the scene changes within the step, or with error control,
        # because then a substep has failed.
        searched = (NO_RATTLE_STEP, NOT_CONVERGED) if not METHODS[self.method].controlled else ()
        if status & 0xFF in searched and not self._instants_inside():
            self._work.clock[:] = 0.0, self.time, self.time
            works = step_that_works(self._integrator, self.step, *self.state(), self._external)
            hint = f": {works:g} s works from here" if works else ""
        if status & 0xFF == ROTATION_TOO_LARGE and self.stabilisation != "projection":
            if self.layout.drifts(self.group):
                hint = ", or stabilisation projection near a singular configuration"
        if status & 0xFF == ROTATION_TOO_LARGE:
            hint += "".join(f"; {note}" for note in self.scene.notes if note.startswith("stiff:"))
        if status & 0xFF == DEPENDENT_ROWS:
            joint = self._joint_name(status >> 8)
        if status & 0xFF == BEYOND_STOP:
            joint = self.layout.switches[status >> 8].name
        if status & 0xFF == TURNS_NOT_COUNTED:
            number, unwrapped = status >> 8, self.scene.unwrapped
            stops = self.layout.switches[number - len(unwrapped) :]
            force = unwrapped[number][1] if number < len(unwrapped) else f"stops {stops[0].name!r}"
        stopped = f"stopped at t = {self.time:.9g} s (step {self.steps}, h = {self.step:g} s): "
        if self.layout.motions and (text := self._beyond_reach()):
            return stopped + text
        text = MESSAGES[status & 0xFF].format(
            joint=joint, force=force, body=body, angle=angle, hint=hint, events=MOST_EVENTS
        )
        if status & 0xFF in FAST and self.layout.lack_of_inertia:
            text += f"; or a degree of freedom has no inertia at this pose, because {self.layout.lack_of_inertia}"
        return stopped + text

    def _beyond_reach(self):
        """Text on driven joints whose motion leads beyond the reach of their loops, or ""."""
        for ahead in STEPS_AHEAD:
            time = self.time + ahead * self.step
            positions = [at(m, time)[0] for m in self.layout.motions_at(time, self._commanded)]
            found = beyond_reach(self.layout.centred, self._pose, positions)
            if found:
                limits = self.layout.limits
                shown = ", ".join(f"{j!r} at {q:.6g} {limits[j].unit}" for j, q in found)
                return (
                    f"the motion of driven joints leads beyond their reach: {shown}, t = {time:.9g} s, "
                    "where the closed loop cannot follow; command positions within its reach"
                )
        return ""
