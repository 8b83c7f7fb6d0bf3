# SPDX-License-Identifier: Apache-2.0
"""Simulation: a scene, a method and a step; advance, sample, push."""
import logging
import math
from dataclasses import dataclass

import numpy as np

from ._compile import warm_up
from .errors import SimulationError
from .integrators.methods import GROUPS, METHODS
from .integrators.rkmk import advance
from .integrators.status import DEPENDENT_ROWS, LARGE_ROTATION, MESSAGES, OK
from .joints.pairs import LOWER_PAIRS
from .model.arrays import Model, make_work
from .model.build import build_model, initial_state
from .model.sample import Sample
from .scene.assembly import ready
from .scene.centres import Offsets
from .scene.consistency import resolve_frames
from .scene.description import Scene
from .wrenches import NEVER, AppliedWrench, WrenchSchedule

log = logging.getLogger("liegroup_core")


@dataclass(frozen=True)
class Layout:
    """The names behind a model's indices, and the frames behind its numbers.

    The model's frames, and those of a state, sit at the centres of mass; those of a Sample and of
    an applied wrench are the body frames of the scene.
    """

    scene: Scene                            # as its author wrote it, but assembled
    centred: Scene                          # the same with its frames at the centres of mass
    offsets: Offsets                        # between the two
    model: Model
    joint_frames: tuple                     # (parent frame, child frame) in the scene's order
    elements: tuple                         # (scene joint, kept rows) of each joint of the model

    @property
    def body_names(self):
        """Names of the bodies in the order of all arrays."""
        return tuple(body.name for body in self.scene.bodies)

    @property
    def dropped_rows(self):
        """[(joint, row)] left out because they depend on others, rows named wx..vz."""
        kept = {joint: rows for joint, rows in self.elements}
        return [(joint.name, name) for j, joint in enumerate(self.scene.joints)
                for r, name in enumerate(LOWER_PAIRS[joint.type].row_names)
                if r not in kept.get(j, ())]

    def sample(self, pose, twist, time=0.0, time_ns=0, steps=0):
        """Sample of body frames as in a Sample or a recording: pose (n, 12), twist (n, 6)."""
        pose, twist = self.offsets.to_centres(np.array(pose), np.array(twist))
        return Sample(self, time, time_ns, steps, pose, twist)


def make_layout(scene):
    """Build the model of a scene. Raises SceneError."""
    scene, centred = ready(scene)
    model, elements = build_model(centred)
    return Layout(scene, centred, Offsets(scene), model, tuple(resolve_frames(scene)),
                  tuple(elements))


class Simulation:
    """A mechanism that is integrated step by step on its Lie group.

    scene  : Scene, from `load_scene` or built in code
    method : name of METHODS, "rkmk4"
    step   : step size h, s
    group  : "se3" for SE(3)^n, or "so3xr3" for (SO(3) x R^3)^n
    raises SceneError for a scene that cannot be simulated, ValueError for a wrong setting

    Order and constraint residuals: test/verification/test_heavy_top.py.
    """

    def __init__(self, scene, method="rkmk4", step=1e-3, group="se3"):
        if method not in METHODS:
            raise ValueError(f"unknown method {method!r}; there are: {', '.join(METHODS)}")
        if group not in GROUPS:
            raise ValueError(f"unknown group {group!r}; there are: {', '.join(GROUPS)}")
        if not (isinstance(step, (int, float)) and math.isfinite(step) and step > 0.0):
            raise ValueError(f"the step must be a positive number of seconds, got {step!r}")
        self.scene, self.method, self.step, self.group = scene, method, float(step), group
        self.layout = make_layout(scene)
        self.tableau = METHODS[method]
        self._work = make_work(self.layout.model, len(self.tableau.b))
        self._body = {name: i for i, name in enumerate(self.layout.body_names)}
        self._warned = self._warned_singular = False
        self.reset()
        warm_up(self._touch)

    def _touch(self):
        """Call every kernel once, so that none is compiled later, in the middle of a run."""
        self._advance(0)
        sample = self.sample()
        return sample.energy, sample.spatial_momentum, sample.quaternions

    def reset(self):
        """Back to the initial state of the scene, at step 0, without wrenches."""
        pose, twist = initial_state(self.layout.centred)
        self.set_state(pose, twist)

    def set_state(self, pose, twist, steps=0):
        """Continue from a state: pose (n, 12), twist (n, 6), at a step count. Ends all wrenches.

        The state is the integrator's own, as `state()` gives it: frames at the centres of mass.
        """
        n = len(self._body)
        pose, twist = np.array(pose, dtype=float), np.array(twist, dtype=float)
        if pose.shape != (n, 12) or twist.shape != (n, 6):
            raise ValueError(f"expected a pose ({n}, 12) and a twist ({n}, 6), "
                             f"got {pose.shape} and {twist.shape}")
        if not (np.isfinite(pose).all() and np.isfinite(twist).all()):
            raise ValueError("the state has a number that is not finite")
        self._pose, self._twist, self.steps = pose, twist, int(steps)
        self._schedule = WrenchSchedule(n)
        self._external = np.zeros((n, 6))   # the same about the centres of mass
        self._applied = []

    def state(self):
        """Copies of pose (n, 12) and twist (n, 6): what the integrator goes on from, to the bit.

        They are of frames with the axes of the body frames and their origins at the centres of
        mass: not those of `sample()` where a body of the scene has a `com` or an offset shape.
        """
        return self._pose.copy(), self._twist.copy()

    @property
    def time(self):
        """Simulated time since the start or the last reset, s."""
        return self.steps * self.step

    @property
    def time_ns(self):
        """The same as an integer of nanoseconds, rounded from the step count."""
        return round(self.steps * self.step * 1e9)

    @property
    def singular_solves(self):
        """How often the accelerations were solved at a singular pose, since the simulation was made.

        There rows depend on each other that do not elsewhere (a parallelogram folded flat); the
        solve is regularised and refined, and where the joints leave it open the masses decide.
        """
        return int(self._work.report[1])

    @property
    def next_wrench_change(self):
        """The first step at which a commanded wrench starts or ends; NEVER if there is none."""
        return self._schedule.next_change()

    def apply_wrench(self, body, wrench, start=None, duration=None, source="api"):
        """Apply a wrench to a body over whole steps.

        body     : name of the body
        wrench   : (6,) torque N m, force N; body axes, about the body frame's origin. Zero ends it.
        start    : simulated time, s, rounded up to a step; None or a time past: the next step
        duration : s, rounded to whole steps, at least one; None: until it is replaced
        source   : each source holds one wrench on a body, sources add
        raises ValueError for an unknown body, a wrong shape, or a number that is not finite
        """
        if body not in self._body:
            raise ValueError(f"unknown body {body!r}; there are: {', '.join(self._body)}")
        wrench = np.asarray(wrench, dtype=float)
        if wrench.shape != (6,) or not np.isfinite(wrench).all():
            raise ValueError("a wrench is six finite numbers (torque, force), got "
                             f"{wrench.tolist()}")
        first = self.steps
        if start is not None:
            # A start that is a step up to rounding is that step, not the next one.
            first = max(first, math.ceil(start / self.step - 1e-6))
        end = NEVER
        if duration is not None:
            if not duration > 0.0:
                raise ValueError(f"a duration must be positive, got {duration!r}")
            end = first + max(1, round(duration / self.step))
        self._schedule.command(source, self._body[body], wrench, first, end)

    def clear_wrenches(self, source="api"):
        """End what a source applies or has scheduled."""
        self._schedule.clear(source)

    def drain_applied(self):
        """The changes of the total wrench on each body since the last call: [AppliedWrench].

        Applied again at the same steps by `apply_wrench(body, wrench)`, they repeat the run bit
        for bit (test/core/test_simulation.py).
        """
        applied, self._applied = self._applied, []
        return applied

    def advance(self, steps=1):
        """Take `steps` steps.

        raises SimulationError, one line, when the integration cannot go on: NaN or overflow, a
        turn of nearly 2 pi in a step, a singular pose. State and `steps` are then those of the
        last good step.
        """
        self._advance(int(steps))

    def _advance(self, steps):
        end = self.steps + steps
        while True:
            for body in self._schedule.update(self.steps):
                self._external[body] = self.layout.offsets.wrench_at_centre(
                    body, self._schedule.total[body])
                self._applied.append(AppliedWrench(
                    self.steps, self.layout.body_names[body],
                    tuple(self._schedule.total[body].tolist())))
            wanted = min(end, self._schedule.next_change()) - self.steps
            done, status = advance(
                self.layout.model, self._work, self.tableau.a, self.tableau.b.reshape(1, -1),
                GROUPS[self.group], self.step, wanted, self._pose, self._twist,
                self._external)
            self.steps += done
            if status != OK:
                raise SimulationError(self._explain(status), status & 0xff)
            if self.steps >= end:
                break
        if self._work.report[1] and not self._warned_singular:
            self._warned_singular = True
            log.warning("a singular pose was met before t = %g s: where the joints leave the motion "
                        "open the masses decide", self.time)
        if not self._warned and self._work.report[0] > LARGE_ROTATION ** 2:
            self._warned = True
            log.warning("a body turned by more than pi within one step (%.3g rad before t = %g s): "
                        "the result is hardly accurate, take a smaller step",
                        math.sqrt(self._work.report[0]), self.time)

    def _explain(self, status):
        joint = ""
        if status & 0xff == DEPENDENT_ROWS:
            joint = self.scene.joints[self.layout.elements[status >> 8][0]].name
        return (f"stopped at t = {self.time:.9g} s (step {self.steps}, h = {self.step:g} s): "
                + MESSAGES[status & 0xff].format(joint=joint))

    def sample(self):
        """The present state as a Sample."""
        return Sample(self.layout, self.time, self.time_ns, self.steps, *self.state())
