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


class Warnings:
    """Warnings of an Engine, each given once; quiet : True: none."""

    def __init__(self, quiet):
        self._quiet, self._given = quiet, set()

    def _is_new(self, name):
        """Whether to warn of `name` now."""
        if self._quiet or name in self._given:
            return False
        self._given.add(name)
        return True

    def give(self, engine):
        """Log the warnings of an Engine after some steps."""
        report, switching = engine._work.report, engine._switching
        if report[SINGULAR_SOLVES] and self._is_new("singular"):
            log.warning(
                "Singular configuration before t = %g s: some constraint equations are "
                "redundant there, and the mass distribution decides the remaining motion. %s"
                "If it is always singular, remove a redundant joint",
                engine.time,
                ""
                if engine.layout.model.projects
                else "If the mechanism only passes this configuration, use stabilisation projection. ",
            )
        if switching is not None:
            self._give_of_events(engine, switching.endless, switching.crowded)
        if report[LARGEST_TURN] > LARGE_ROTATION**2 and self._is_new("turn"):
            turned = math.sqrt(report[LARGEST_TURN])
            log.warning(
                "%s, step %g s: a body rotated by more than pi within one step (%.3g rad "
                "before t = %g s), so the result is inaccurate. Use a step below %.2g s",
                engine.method,
                engine.step,
                turned,
                engine.time,
                LARGE_ROTATION / turned * engine.step,
            )

    def _give_of_events(self, engine, endless, crowded):
        if endless and self._is_new("endless"):
            log.warning(
                "At t = %.9g s impacts follow each other without end at %s: they are plastic until the end "
                "of the step, which dissipates energy",
                endless[0],
                _names_of_switches(engine, endless[1]),
            )
        if crowded and self._is_new("crowded"):
            log.warning(
                "At t = %.9g s events follow each other at intervals of %.2g s at %s: each of them is found, "
                "so the run is slow. Widen the gap, reduce the restitution, or use a compliant stop",
                crowded[0],
                crowded[2],
                _names_of_switches(engine, crowded[1]),
            )


def _names_of_switches(engine, numbers):
    return ", ".join(sorted({engine.layout.switches[k].name for k in numbers}))


def _joint_name(engine, element):
    """Name of the scene joint to which an element of the model belongs, or of a coupling."""
    owners = engine.layout.owners
    if element >= len(owners):
        return engine.scene.couplings[element - len(owners)].name
    return engine.scene.joints[owners[element]].name


def explain(engine, status):
    """Why an Engine stopped with a status, in one line."""
    joint = force = body = hint = ""
    # RATTLE reports the rotation of its step equation, which includes the effect of the torque.
    angle = math.sqrt(engine._work.report[STEP_TURN])
    if status & 0xFF == NO_RATTLE_STEP:
        body = engine.layout.body_names[status >> 8]
    # No smaller step is suggested if a wrench of the scene changes within the step, or with error control,
    # because then a substep has failed.
    searched = (NO_RATTLE_STEP, NOT_CONVERGED) if not METHODS[engine.method].controlled else ()
    if status & 0xFF in searched and not engine._instants_inside():
        engine._work.clock[:] = 0.0, engine.time, engine.time
        works = step_that_works(engine._integrator, engine.step, *engine.state(), engine.inputs.external)
        hint = f": {works:g} s works from here" if works else ""
    if status & 0xFF == ROTATION_TOO_LARGE and engine.stabilisation != "projection":
        if engine.layout.drifts(engine.group):
            hint = ", or stabilisation projection near a singular configuration"
    if status & 0xFF == ROTATION_TOO_LARGE:
        hint += "".join(f"; {note}" for note in engine.scene.notes if note.startswith("stiff:"))
    if status & 0xFF == DEPENDENT_ROWS:
        joint = _joint_name(engine, status >> 8)
    if status & 0xFF == BEYOND_STOP:
        joint = engine.layout.switches[status >> 8].name
    if status & 0xFF == TURNS_NOT_COUNTED:
        number, unwrapped = status >> 8, engine.scene.unwrapped
        stops = engine.layout.switches[number - len(unwrapped) :]
        force = unwrapped[number][1] if number < len(unwrapped) else f"stops {stops[0].name!r}"
    stopped = f"stopped at t = {engine.time:.9g} s (step {engine.steps}, h = {engine.step:g} s): "
    if engine.layout.motions and (text := _beyond_reach(engine)):
        return stopped + text
    text = MESSAGES[status & 0xFF].format(
        joint=joint, force=force, body=body, angle=angle, hint=hint, events=MOST_EVENTS
    )
    if status & 0xFF in FAST and engine.layout.lack_of_inertia:
        text += f"; or a degree of freedom has no inertia at this pose, because {engine.layout.lack_of_inertia}"
    return stopped + text


def _beyond_reach(engine):
    """Text on driven joints whose motion leads beyond the reach of their loops, or ""."""
    for ahead in STEPS_AHEAD:
        time = engine.time + ahead * engine.step
        positions = [at(m, time)[0] for m in engine.layout.motions_at(time, engine.inputs.commanded)]
        found = beyond_reach(engine.layout.centred, engine._pose, positions)
        if found:
            limits = engine.layout.limits
            shown = ", ".join(f"{j!r} at {q:.6g} {limits[j].unit}" for j, q in found)
            return (
                f"the motion of driven joints leads beyond their reach: {shown}, t = {time:.9g} s, "
                "where the closed loop cannot follow; command positions within its reach"
            )
    return ""
