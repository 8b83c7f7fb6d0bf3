# SPDX-License-Identifier: Apache-2.0
"""Engine: integrates one scene with one method and one step size."""

import copy
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from liegroup_core.compiling import warm_up
from liegroup_core.errors import SimulationError
from liegroup_core.fields.arguments import finite, floats, got, is_count, is_finite
from liegroup_core.forces.instants import NEVER, StepGrid
from liegroup_core.forces.schedule import DRIVE
from liegroup_core.forces.timetable import Timetable
from liegroup_core.inputs import Inputs
from liegroup_core.joint_events import JointEvents
from liegroup_core.layout import Layout, make_layout
from liegroup_core.mechanism.bodies import COUNT, NOW, OFFSET, SINGULAR_SOLVES
from liegroup_core.mechanism.body_model import initial_state
from liegroup_core.methods.families import check_group, check_options, choose_group, make_integrator
from liegroup_core.methods.table import METHODS, is_positive
from liegroup_core.observables.reactions import REGULAR
from liegroup_core.observables.sample import Sample
from liegroup_core.placing import Placing
from liegroup_core.reports import Reports
from liegroup_core.scene.description import Scene
from liegroup_core.status import OK

Floats = NDArray[np.float64]


STABILISATIONS = ("none", "projection", "baumgarte")
# Default of Baumgarte's time constant, in steps. Explicit methods are stable above half a step.
BAUMGARTE_STEPS = 10
# Largest entry of R R^T - 1 that `set_state` accepts.
NO_ROTATION = 1e-6
METHOD, STEP = "rkmk4", 1e-3  # defaults; s
# Number of steps per call of a kernel at first, and range of the wall time in s of later calls.
FIRST_BLOCK, QUICK, SLOW = 16, 0.01, 0.03


def _next_block(steps, seconds):
    """Number of steps for the next call of a kernel, after `steps` took `seconds`."""
    if seconds < QUICK:
        return 2 * steps
    return max(1, steps // 2) if seconds > SLOW else steps


def _stabilised(model, kind, constant, step):
    """Enable a stabilisation in a model. Raises ValueError for an invalid option."""
    if kind not in STABILISATIONS:
        raise ValueError(f"unknown stabilisation {kind!r}; choose one of: {', '.join(STABILISATIONS)}")
    if constant is None:
        constant = BAUMGARTE_STEPS * step
    elif kind != "baumgarte":
        raise ValueError(f"baumgarte_time requires stabilisation 'baumgarte', got {kind!r}")
    if not (is_finite(constant) and constant >= step):
        raise ValueError(
            f"baumgarte_time must be a number of seconds and at least one step ({step:g} s), {got(constant)}"
        )
    return model.replace(projects=kind == "projection", baumgarte_rate=1.0 / constant if kind == "baumgarte" else 0.0)


class Engine(Inputs, JointEvents, Placing, Reports):
    """Mechanism that is integrated on its Lie group by one method with one step size.

    scene  : Scene, from `load_scene` or built in code
    method : name of METHODS; default "rkmk4"
    step   : step size h, s; default 1e-3. A method with error control takes substeps within it
    group  : configuration space: "se3" for SE(3)^n, "so3xr3" for (SO(3) x R^3)^n, "relative" for
             the product of the joints' motion groups (all families but the rotation methods).
             "auto": "relative", for rotation methods "so3xr3"
    stabilisation : treatment of constraint drift: "none"; "projection" of poses and velocities
                    after every step; or "baumgarte", which damps the drift with the time constant
                    baumgarte_time
    baumgarte_time : s, at least the step; default: ten steps
    options: further options of the method, see its family in `integrators`:
             dexpinv="exact" or "truncated"  of explicit Munthe-Kaas methods, rkmk...
             space="auto" or "space"         of the same, radau5, generalized_alpha and
                                             constrained_rattle; "auto": in relative coordinates
                                             planar mechanisms move in their plane; "space": in space
             rtol=1e-6, atol=1e-6            tolerances of methods with error control (rkmk54,
                                             rkmk853, radau5)
             rho_inf=0.8                     damping of generalized_alpha
    quiet    : True: log no warnings
    layout   : of the scene, if it was made before
    Raises SceneError for a scene that cannot be simulated, ValueError for an invalid option or a
    method that cannot integrate the scene.

    Orders: test/verification/test_orders.py; constraint residuals: test_heavy_top.py.
    """

    def __init__(
        self,
        scene: Scene,
        method: str | None = None,
        step: float | None = None,
        group: str = "auto",
        stabilisation: str = "none",
        baumgarte_time: float | None = None,
        quiet: bool = False,
        layout: Layout | None = None,
        **options: Any,
    ) -> None:
        if not isinstance(scene, Scene):
            raise ValueError(f"expected a Scene, got {scene!r}; use load_scene to read one from a file")
        method = METHOD if method is None else method
        step = STEP if step is None else step
        if not isinstance(method, str) or method not in METHODS:
            raise ValueError(f"unknown method {method!r}; choose one of: {', '.join(METHODS)}")
        if not is_positive(step):
            raise ValueError(f"the step must be a positive number of seconds, {got(step)}")
        self.scene, self.method, self.step = scene, method, float(step)
        check_group(method, group)
        self.options = check_options(method, options)
        self.stabilisation, self.baumgarte_time = stabilisation, baumgarte_time
        layout = make_layout(scene) if layout is None else layout
        self.layout = layout.with_model(_stabilised(layout.model, stabilisation, baumgarte_time, self.step))
        self.group = choose_group(method, group)
        self._integrator = make_integrator(method, self.layout, self.group, self.step, self.options)
        self._work = self._integrator.work
        self._switching = getattr(self._integrator, "switching", None)
        self._body = {name: i for i, name in enumerate(self.layout.body_names)}
        rows, motions = self.layout.model.forces.applied_wrench, self.layout.motions.values()
        self._grid = StepGrid(self.step)
        self._timetable = Timetable(rows, self._grid, motions)
        self._warned = self._warned_singular = quiet
        self._warned_endless = self._warned_crowded = quiet
        self._start = initial_state(self.layout.centred)
        self._block, self._halted = FIRST_BLOCK, False
        warm_up(self._touch)

    def __copy__(self) -> "Engine":
        return copy.deepcopy(self)  # a shallow copy would share the state

    def _touch(self):
        """Call every kernel once, so that no kernel is compiled during a run."""
        self.reset()
        self._advance(0)
        if self._switching is not None:
            self._switching.touch(self._pose, self._twist, self._external)
            self.reset()
        sample = self.sample()
        return (
            sample.energy,
            sample.power,
            sample.spatial_momentum,
            sample.quaternions,
            sample.rows,
            sample.joint_coordinates,
            sample.constraint_residual,
        )

    def reset(self) -> None:
        """Return to the initial state at step 0, and clear all applied wrenches and efforts."""
        self.set_state(*self._start)

    def set_state(
        self,
        pose: ArrayLike,
        twist: ArrayLike,
        steps: int = 0,
        angles: ArrayLike | None = None,
        memory: bytes | None = None,
    ) -> None:
        """Continue from a state at a step count.

        pose, twist : (n, 12), (n, 6) of frames at the centres of mass, as `state()` returns them
        angles : (k,) rad, `Sample.angles` of the state: unwrapped angles. None:
                 all are in (-pi, pi], as at the start of a scene
        memory : bytes from `memory()` at this state: the run continues bit-identically. None: a
                 method with memory restarts, and angles of joints with stops or friction are unwrapped
                 near 0, as far as the stops allow. `place` keeps the whole turns
        steps  : 0 or more
        Clears the applied wrenches and efforts. The wrenches of the scene follow the step count.
        Raises ValueError for wrong shapes, non-finite numbers, matrices that are not rotations, an invalid
        step count, or a memory of another method.
        """
        n = len(self._body)
        pose = floats(f"expected a pose ({n}, 12)", pose)
        twist = floats(f"expected a twist ({n}, 6)", twist)
        if pose.shape != (n, 12) or twist.shape != (n, 6):
            raise ValueError(f"expected a pose ({n}, 12) and a twist ({n}, 6), got {pose.shape} and {twist.shape}")
        if not (np.isfinite(pose).all() and np.isfinite(twist).all()):
            raise ValueError("the state contains NaN or infinity")
        turned = pose[:, :9].reshape(n, 3, 3)
        off = np.abs(turned @ turned.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
        for i in np.flatnonzero((off > NO_ROTATION) | (np.linalg.det(turned) < 0.0)):
            raise ValueError(f"pose of {self.layout.body_names[i]}: the first nine numbers are not a rotation matrix")
        k = len(self._work.angle)
        if angles is not None:
            angles = finite(f"expected {k} finite angles, as `Sample.angles`", angles, (k,))
        if not (is_count(steps) and steps < NEVER):
            raise ValueError(f"steps must be a whole number from 0 to {NEVER - 1}, {got(steps)}")
        if memory is not None:
            self._check_memory(memory)
        self._start_at(pose, twist, int(steps), self.layout.angles(pose, angles))
        if memory is not None:
            self._remember(memory)

    def _start_at(self, pose, twist, steps, angles):
        """Continue from a valid state; the engine takes over its arrays."""
        self._work.angle[:] = angles
        self._pose, self._twist, self.steps = pose, twist, steps
        self._clear_inputs()
        self._integrator.restart()

    def follow(self, other, steps):
        """Continue from the state of another engine of the same scene at a step count, with its inputs."""
        self._start_at(*other.state(), steps, other._work.angle)
        self.take_modes(other)
        for change in other.acting():
            change.repeat(self)

    def _check_memory(self, memory):
        """Raise ValueError unless `memory` is as long as the memory of this method."""
        size = len(self.memory())
        if not isinstance(memory, (bytes, bytearray)):
            raise ValueError(f"expected {size} bytes of method memory, {got(memory)}")
        if len(memory) != size:
            raise ValueError(
                f"expected {size} bytes of method memory, got {len(memory)}: it belongs to another method or version"
            )

    def _remember(self, memory):
        at = 0
        for array in self._integrator.memory:
            array[...] = np.frombuffer(memory, array.dtype, array.size, at).reshape(array.shape)
            at += array.nbytes

    def state(self) -> tuple[Floats, Floats]:
        """Copies of the integrator's pose (n, 12) and twist (n, 6), for `set_state`.

        They refer to frames with the axes of the body frames and their origins at the centres of
        mass. They differ from those of `sample()` if a body has a `com` or an offset shape.
        """
        return self._pose.copy(), self._twist.copy()

    def at_bodies(self) -> tuple[Floats, Floats]:
        """Pose (n, 12) and twist (n, 6) of the body frames, read-only: possibly not copies."""
        return self.layout.offsets.to_bodies(self._pose, self._twist)

    def memory(self) -> bytes:
        """Bytes of the method's memory between steps, for `set_state`.

        In group "relative" the coordinates of the joints. Methods with error control add the size of
        the substep, implicit methods accelerations and initial guesses.
        """
        return b"".join(array.tobytes() for array in self._integrator.memory)

    def snapshot(self) -> dict[str, Any]:
        """Copy of the whole state, with the wrenches of `apply_wrench`, for `restore`."""
        return {
            "state": (*self.state(), self.steps, self._work.angle.copy()),
            "memory": Engine.memory(self),
            "schedule": self._schedule.copy(),
            "external": self._external.copy(),
            "wanted": self._work.wanted.copy(),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Return to a snapshot of this simulation. The continuation is bit-identical."""
        self._pose[:], self._twist[:], self.steps, self._work.angle[:] = snapshot["state"]
        self._integrator.restart()
        Engine._remember(self, snapshot["memory"])
        self._schedule, self._applied = snapshot["schedule"].copy(), []
        self._external[:] = snapshot["external"]
        self._work.wanted[:] = snapshot["wanted"]
        self._commanded[:] = self._schedule.total[DRIVE]

    @property
    def time(self) -> float:
        """Simulated time since the start or the last reset, s."""
        return self.steps * self.step

    @property
    def time_ns(self) -> int:
        """Simulated time in integer nanoseconds, rounded from step count times step."""
        return self._grid.time_ns(self._grid.boundary(self.steps))

    @property
    def singular_solves(self) -> int:
        """Number of acceleration solves at a singular pose so far.

        At a singular pose, such as a flat parallelogram, constraint rows become dependent. The solve
        is regularised and refined; accelerations that the joints leave undetermined follow from the
        masses.
        """
        return int(self._work.report[SINGULAR_SOLVES])

    @property
    def substeps(self) -> tuple[int, int]:
        """Accepted and attempted substeps since the state was set; (0, 0) without error control."""
        return self._integrator.substeps

    def limit_substeps(self, longest):
        """Set the longest substep in s of a method with error control; call it at the start."""
        self._integrator.limit(longest)

    @property
    def freedoms(self):
        """Number of freedoms that a Munthe-Kaas method integrates."""
        return self._integrator.freedoms

    def limit_attempts(self, most):
        """Set the most attempted substeps in a step of a method with error control."""
        self._integrator.limit_attempts(most)

    def halt(self) -> None:
        """End an `advance` of another thread after its last valid step, within a few ms."""
        self._halted = True
        if METHODS[self.method].controlled:  # a step may have 100 000 substeps
            self._integrator.limit_attempts(0)

    def _go_on(self):
        """Allow `advance` again after `halt`."""
        self._halted = False
        if METHODS[self.method].controlled:
            self._integrator.limit_attempts()

    def advance(self, steps: int = 1, enough: Callable[[], bool] | None = None) -> None:
        """Take `steps` steps, an integer >= 0.

        enough : called about every 20 ms of wall time, or after each step that takes longer; if it returns
                 True, no more steps are taken

        Python handles signals equally often, so that Ctrl-C ends a call. Raises ValueError for other numbers.
        Raises SimulationError if the integration cannot continue: NaN or overflow, a rotation of nearly
        2 pi in a step, constraints that cannot be satisfied, an implicit step without solution, an
        unreachable tolerance. State and `steps` are then those of the last valid step.
        """
        if not is_count(steps):
            raise ValueError(f"steps must be a whole number, 0 or more, {got(steps)}")
        if self._halted:
            self._go_on()
        self._advance(int(steps), enough)

    def advance_to(self, steps):
        """As `advance`, up to a step count that is not before the present one."""
        self._advance(steps - self.steps)

    def _advance(self, steps, enough=None):
        end = self.steps + steps
        while True:
            start = self._grid.boundary(self.steps)
            change = min(end, self._timetable.next_change(self.steps))
            inside = self._timetable.inside(self.steps)
            if self._schedule:
                self._change_wrenches(start, self._schedule.update(start))
                change = min(change, self._schedule.next_change(self.steps))
                inside = self._instants_inside()
            steps, began = change - self.steps, 0.0
            if steps > self._block:
                steps, began = self._block, time.perf_counter()
            done, status = self._take_steps(start, steps, inside)
            self.steps += done
            if self.steps >= end and status == OK:
                break
            if self._halted:
                return
            self._checked(status)
            if began:
                self._block = _next_block(done, time.perf_counter() - began)
            if enough is not None and enough():
                break
        self._give_warnings()

    def peek(self, steps: int, part: float) -> tuple[Floats, Floats]:
        """State after some steps and a part of one, as `state`; the present state does not change.

        Raises SimulationError, as `advance`.
        """
        kept = Engine.snapshot(self)
        try:
            self._advance(steps)
            if part:
                start, end = self._grid.boundary(self.steps), self._grid.end(self.steps, part)
                self._change_wrenches(start, self._schedule.update(start))
                inside = [instant for instant in self._instants_inside() if instant < end]
                self._checked(self._take_in_parts(start, inside, part * self.step, end))
            return self.state()
        finally:
            Engine.restore(self, kept)

    def _checked(self, status):
        if status != OK:
            raise SimulationError(self._explain(status), status & 0xFF)

    def _take_steps(self, start, steps, inside):
        """Take steps in which no wrench changes, or one step in parts if one changes.

        start  : Instant of the present step
        inside : Instants in the first step at which a wrench may start or end
        returns (steps done, status)
        """
        if not inside or steps == 0:
            return self._integrate(start, self.step, steps)
        good = self._pose.copy(), self._twist.copy(), self._work.angle.copy()
        status = self._take_in_parts(start, inside, self.step, self._grid.end(self.steps))
        if status != OK:
            self._pose[:], self._twist[:], self._work.angle[:] = good
            self._integrator.restart()
            return 0, status
        return 1, OK

    def _take_in_parts(self, start, inside, h, end):
        """Take a step of size h, between two Instants, in parts between those inside; returns a status."""
        begin = start
        for instant in sorted(inside):
            changed = self._schedule.update(instant)
            # A part ends only where a total changes: the recorded totals repeat the same parts.
            if changed or instant in self._timetable.inside(self.steps):
                status = self._take_part(begin, self._grid.between(begin, instant))
                if status != OK:
                    return status
                self._change_wrenches(instant, changed)
                begin = instant
        return self._take_part(begin, h if begin is start else self._grid.between(begin, end))

    def _take_part(self, start, h):
        """Take a part of a step of size h from an Instant on; returns a status."""
        return self._integrate(start, h / self._parts, self._parts)[1]

    def _integrate(self, start, h, steps):
        """Take steps of size h from an Instant on, in which no wrench changes.

        returns (steps done, status)
        """
        self._set_inputs(start, h)
        return self._integrator.advance(h, steps, self._pose, self._twist, self._external)

    def _set_inputs(self, start, h):
        """Set the time-dependent inputs of a step of size h from an Instant on."""
        work, time = self._work, start.time
        if len(work.acting):
            work.acting[:] = self._timetable.acting(start)
        if len(work.motions):
            # The middle is away from all changes: round-off has no influence.
            work.motions[:] = self.layout.motions_at(time + 0.5 * h, self._commanded)
        clock, whole = work.clock, h == self.step and not start.offset
        clock[COUNT], clock[OFFSET], clock[NOW] = (self.steps, 0.0, time) if whole else (0.0, time, time)

    def sample(self) -> Sample:
        """Create a Sample of the present state."""
        sample = Sample(self.layout, self.time, self.time_ns, self.steps, *self.state(), self._work.angle.copy())
        if self._schedule:
            sample.external = self._external.copy()
            sample.joint_efforts = self._schedule.efforts
        if len(self._work.wanted):
            sample.wanted = self._work.wanted.copy()
        if self._switching is not None:
            sample.switching = self._modes_now()
        if len(self._work.motions):
            sample.motions = self.layout.motions_at(self.time, self._commanded)
        return sample

    def _modes_now(self):
        """(k, 5) modes of the joints with stops or friction, see Sample.switching."""
        self._set_inputs(self._grid.boundary(self.steps), self.step)
        return self._switching.modes(self.time, (self._pose, self._twist, self._external))

    def reaction_array(self, out: Floats | None = None) -> Floats:
        """Reactions of all joints at the present state, bit-identical to those of a Sample.

        out : (J, 6) array, of any memory layout, that takes them; None: a new one
        returns (J, 6) torque N m, force N of the joints in the order of the scene; see
        Sample.reactions. Raises SimulationError if they cannot be computed.
        """
        reactions = self.layout.reactions
        if not reactions.names:
            return self._given(np.empty((0, 6)), out)
        found = reactions.empty()
        if reactions.has_inputs:
            reactions.take(*self._inputs_now())
        external = self._external if self._schedule else reactions.idle
        if reactions.present(self._pose, self._twist, external, found) != REGULAR:
            return self._given(self.sample().reaction_array, out)  # a singular pose, or an error
        return self._given(found[: len(reactions.names)], out)

    @staticmethod
    def _given(found, out):
        if out is None:
            return found
        out[...] = found
        return out

    def _inputs_now(self):
        """Inputs of reactions besides the state and external wrenches; see Reactions.at."""
        work, modes = self._work, None
        if self._switching is not None:
            if not self.layout.reactions.take_modes(*self._integrator.links):
                modes = self._modes_now()
        acting = work.acting
        if len(acting):
            acting = self._timetable.acting(self._grid.boundary(self.steps))
        motions = self.layout.motions_at(self.time, self._commanded)
        return work.angle, acting, work.wanted, motions, modes, self.time

    def energy(self) -> float:
        """Kinetic energy plus potential energy of gravity and springs at the present state, J."""
        return self.sample().energy
