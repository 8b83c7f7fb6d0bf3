# SPDX-License-Identifier: Apache-2.0
"""Messages of an Engine: warnings, and why it stopped."""

import logging
import math
from time import thread_time

import numpy as np

from liegroup_core.forces.contact import LOOK, stiff_note
from liegroup_core.forces.law import owners_of_kinks, undefined_of
from liegroup_core.joints.limits import BeyondLimits
from liegroup_core.joints.motion import at, overshoot
from liegroup_core.mechanism.bodies import DEEPEST, DEEPEST_OF, LARGEST_TURN, NEAR_SOLVES, SINGULAR_SOLVES, STEP_TURN
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
    NOT_FINITE,
    ROTATION_TOO_LARGE,
    SUBSTEP_TOO_SMALL,
    TOO_MANY_SUBSTEPS,
    TURNS_NOT_COUNTED,
)

log = logging.getLogger("liegroup_core")

# Statuses that fast motion may cause.
FAST = {ROTATION_TOO_LARGE, TURNS_NOT_COUNTED, NOT_CONVERGED, SUBSTEP_TOO_SMALL, TOO_MANY_SUBSTEPS, NOT_FINITE}
PATIENCE = 0.5  # s of CPU time
DEEP = 0.5  # of the depth from which on a contact pushes two bodies apart on the other side
STEPS_OF_EVENT = 5  # steps of the method that find the time of an event, about
FEW = 4  # substeps in a step
OF_CONTACTS = "contacts cost less with less stiffness, more damping, a longer slip, or fewer points"
# Steps after the last valid one at which a driven joint may be beyond the reach of its loop.
STEPS_AHEAD = (1, 2, 4)


class Warnings:
    """Warnings of an Engine, each given once; quiet : True: none."""

    def __init__(self, quiet):
        self._quiet, self._given = quiet, set()
        self._since = self._spent = 0.0  # s: time of the motion from which CPU time is counted, and that
        self._was_slow = False

    def begin(self):
        """Begin to count the CPU time of steps; call `give` after them."""
        if not self._quiet:
            self._began = thread_time()

    def late(self, text):
        """Log the first command that came late."""
        if not self._quiet and self._is_new("late"):
            log.warning("%s", text)

    def _is_new(self, name):
        """Whether to warn of `name` now."""
        if name in self._given:
            return False
        self._given.add(name)
        return True

    def give(self, engine):
        """Log the warnings of an Engine after some steps."""
        if self._quiet:
            return
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
        if report[NEAR_SOLVES] and not report[SINGULAR_SOLVES] and self._is_new("near"):
            log.warning(
                "Before t = %g s a closed loop passes a singular configuration, or 0.1 rad beside one: two "
                "motions satisfy its joints there. The run goes straight on; small differences decide for a machine",
                _reached(engine),
            )
        if switching is not None and switching.endless and self._is_new("endless"):
            log.warning(
                "At t = %.9g s impacts follow each other without end at %s: they are plastic until the end "
                "of the step, which dissipates energy",
                switching.endless[0],
                _names_of_switches(engine, switching.endless[1]),
            )
        if engine.layout.motions and self._is_new("motions"):
            for note in notes_on_motions(engine.layout):
                log.warning("%s", note)
        if report[DEEPEST] * LOOK > DEEP and self._is_new("deep"):
            row = engine.layout.model.forces.laws.closing[int(report[DEEPEST_OF])]
            log.warning(
                "Before t = %g s contact %s is %.2g m deep; its bodies pass through each other at %.2g m: give it more "
                "stiffness",
                _reached(engine),
                owners_of_kinks(engine.layout.centred.forces)[row["kink"]],
                report[DEEPEST] * row["size"],
                row["size"] / LOOK,
            )
        self._give_of_cost(engine)
        controlled = METHODS[engine.method].controlled  # then tolerances limit substeps, whatever they turn
        if not controlled and self._is_new("contact"):
            for note in stiff_note(engine.scene.forces, engine.step):
                log.warning("%s, step %g s is too long; %s", engine.method, engine.step, note)
        if not controlled and report[LARGEST_TURN] > LARGE_ROTATION**2 and self._is_new("turn"):
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

    def _give_of_cost(self, engine):
        """Warn of a run that is slower than real time twice in a row, for PATIENCE s of CPU time: a start is dear."""
        now = thread_time()
        self._spent, self._began = self._spent + now - self._began, now
        advanced = engine.time - self._since
        if self._spent < PATIENCE or advanced == 0.0:
            return
        is_slow = 0.0 <= advanced < self._spent
        if is_slow and self._was_slow and self._is_new("cost"):
            log.warning(
                "A second of the motion takes %.2g s of CPU time at t = %.3g s: %s",
                self._spent / max(advanced, engine.step),
                engine.time,
                cause_of_cost(engine),
            )
        self._was_slow, self._since, self._spent = is_slow, engine.time, 0.0


def _reached(engine):
    """Time in s up to which an Engine has integrated, which may be ahead of its own."""
    steps, more = engine.lead
    return max(engine.time, steps * engine.step + more)


def notes_on_motions(layout):
    """Notes of motions of the scene that would be refused as commands, or that overshoot their points."""
    notes = []
    for joint, rows in layout.motions.items():
        limits = layout.limits[joint]
        try:
            limits.check_motion(rows, rows[1:, 1], rows[1:, 2])
        except BeyondLimits as error:
            notes.append(f"motion beyond the joint limits, which do not act on it: {error}")
        if found := overshoot(rows):
            time, first, second, by = found
            where = f"{by:.3g} {limits.unit} between {first:.6g} and {second:.6g} from t = {time:.6g} s on"
            notes.append(
                f"motion overshoots its points: that of joint {joint!r} by {where}; monotone: true prevents it"
            )
    return notes


def cause_of_cost(engine):
    """What makes a run slow, and what helps."""
    switching, steps = engine._switching, max(1, engine.steps)
    accepted, attempted = engine.substeps
    if switching is not None and switching.tally.sum() * STEPS_OF_EVENT > max(attempted, steps):
        tally, joints = switching.tally, engine.layout.switches
        names = [switch.name for switch in joints] + owners_of_kinks(engine.layout.centred.forces)
        most = np.argsort(-tally, kind="stable")[:3]
        shown = ", ".join(f"{names[k]} ({tally[k]})" for k in most if tally[k])
        if names[most[0]] in engine.layout.touching.names:
            advice = OF_CONTACTS
        elif most[0] >= len(joints):
            advice = "a law that jumps back and forth needs a smooth change, such as tanh, or friction of the joint"
        else:
            advice = (
                "give these joints a wider range, compliant stops or less restitution, or leave their limits and "
                "friction out"
            )
        return f"{tally.sum()} events, most at {shown}; {advice}"
    stiff = [note for note in engine.scene.notes if note.startswith("stiff:")]
    if attempted > FEW * steps:
        text = f"a step of {engine.step:g} s has {attempted / steps:.3g} substeps; "
        if engine.layout.touching.names:
            text += OF_CONTACTS
        else:
            text += f"{'a coarser accuracy' if _to_accuracy(engine) else 'a larger tolerance'} has fewer"
        return "; ".join([text, *stiff])
    count = len(engine.scene.bodies)
    return f"{count} {'body' if count == 1 else 'bodies'} with steps of {engine.step:g} s; larger steps cost less"


def _names_of_switches(engine, numbers):
    return ", ".join(sorted({engine.layout.switches[k].name for k in numbers}))


def _joint_name(engine, element):
    """Name of the scene joint to which an element of the model belongs, or of a coupling."""
    owners = engine.layout.owners
    if element >= len(owners):
        return engine.scene.couplings[element - len(owners)].name
    return engine.scene.joints[owners[element]].name


def explain(engine, status):
    """When and why an Engine stopped with a status, in one line."""
    return f"stopped at t = {engine.time:.9g} s (step {engine.steps}, h = {engine.step:g} s): {reason(engine, status)}"


def reason(engine, status):
    """Why an Engine stopped with a status."""
    joint = force = body = hint = ""
    if status & 0xFF == DEPENDENT_ROWS and status >> 8 >= len(engine.layout.owners) + len(engine.scene.couplings):
        status = NOT_FINITE  # a state of a law, whose row depends on no other
    # RATTLE reports the rotation of its step equation, which includes the effect of the torque.
    angle = math.sqrt(engine._work.report[STEP_TURN])
    if status & 0xFF == NO_RATTLE_STEP:
        body = engine.layout.body_names[status >> 8]
    # No smaller step is suggested if a wrench of the scene changes within the step, or with error control,
    # because then a substep has failed.
    searched = (NO_RATTLE_STEP, NOT_CONVERGED) if not METHODS[engine.method].controlled else ()
    if status & 0xFF in searched and not engine.changes_before(engine.steps + 1):
        engine._work.clock.numbers[:3] = 0.0, engine.base.time, engine.base.time
        state = engine._pose.copy(), engine._twist.copy()
        works = step_that_works(engine._integrator, engine.step, *state, engine.inputs.acting.external)
        hint = f": {works:g} s works from here" if works else ""
    if status & 0xFF == ROTATION_TOO_LARGE and engine.stabilisation != "projection":
        if engine.layout.drifts(engine.group):
            hint = ", or stabilisation projection near a singular configuration"
    if status & 0xFF == DEPENDENT_ROWS:
        joint = _joint_name(engine, status >> 8)
    if status & 0xFF == BEYOND_STOP:
        joint = engine.layout.switches[status >> 8].name
    if status & 0xFF == TURNS_NOT_COUNTED:
        number, unwrapped = status >> 8, engine.scene.unwrapped
        stops = engine.layout.switches[number - len(unwrapped) :]
        force = unwrapped[number][1] if number < len(unwrapped) else f"stops {stops[0].name!r}"
    if engine.layout.motions and (text := _beyond_reach(engine)):
        return text
    # A stage beyond the last valid state, not one of an attempt before it.
    undefined = undefined_of(engine.scene.forces, engine._work.registers)
    if status & 0xFF in FAST and undefined and undefined[0] >= engine.base.time:
        return undefined[1]
    smaller, fewer = _advice(engine)
    text = MESSAGES[status & 0xFF].format(
        joint=joint, force=force, body=body, angle=angle, hint=hint, events=MOST_EVENTS, smaller=smaller, fewer=fewer
    )
    if status & 0xFF in FAST:
        notes = [note for note in engine.scene.notes if note.startswith("stiff:")]
        if not METHODS[engine.method].controlled:
            notes += stiff_note(engine.scene.forces, engine.step)
        text += "".join(f"; {note}" for note in notes)
    if status & 0xFF in FAST and engine.layout.lack_of_inertia:
        text += f"; or a degree of freedom has no inertia at this pose, because {engine.layout.lack_of_inertia}"
    return text


def _to_accuracy(engine):
    return getattr(engine._integrator, "passes", False)


def _advice(engine):
    """What helps against steps that are too large, and against too many substeps."""
    if not METHODS[engine.method].controlled:
        return "use a smaller step", ""
    if _to_accuracy(engine):
        return ("a force, a command or a speed is too large, or a body too light, for any step",) * 2
    return (
        "use smaller tolerances",
        "use a smaller step, larger tolerances, or an accuracy or method radau5 if the scene is stiff",
    )


def _beyond_reach(engine):
    """Text on driven joints whose motion leads beyond the reach of their loops or cams, or ""."""
    for ahead in STEPS_AHEAD:
        time = engine.time + ahead * engine.step
        positions = [at(m, time)[0] for m in engine.inputs.acting.motions]
        found = beyond_reach(engine.layout.centred, engine._pose, positions, engine._work.angle)
        if found:
            limits = engine.layout.limits
            shown = ", ".join(f"{j!r} at {q:.6g} {limits[j].unit}" for j, q in found)
            return (
                f"the motion of driven joints leads beyond their reach: {shown}, t = {time:.9g} s, "
                "where the closed loop or the cam cannot follow; command positions within its reach"
            )
    return ""
