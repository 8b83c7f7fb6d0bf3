# SPDX-License-Identifier: Apache-2.0
"""Engine: integrates one scene with one step size."""

import contextlib
import copy
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from liegroup_core.compiling import warm_up
from liegroup_core.control import Controls
from liegroup_core.errors import SimulationError
from liegroup_core.fields.arguments import finite, floats, got, is_count, is_finite
from liegroup_core.forces.instants import AFTER, LATEST, NEVER, NOT_AHEAD, StepGrid
from liegroup_core.forces.law import WITNESS
from liegroup_core.forces.sampled import Sampling
from liegroup_core.inputs import Inputs
from liegroup_core.joint_events import JointEvents
from liegroup_core.layout import Layout, make_layout
from liegroup_core.mechanism.bodies import DEEPEST, LARGEST_TURN, SINGULAR_SOLVES
from liegroup_core.mechanism.body_model import initial_state
from liegroup_core.methods.families import choose_group, make_integrator
from liegroup_core.methods.table import METHODS
from liegroup_core.observables.reactions import REGULAR
from liegroup_core.observables.sample import Sample
from liegroup_core.parts import method_of, property_of
from liegroup_core.placing import place
from liegroup_core.reports import Warnings, explain
from liegroup_core.scene.description import Scene
from liegroup_core.settings import SETTINGS, check_group, check_options, checked
from liegroup_core.state import State, decoded, kept, set_kept
from liegroup_core.status import EVENT, NOT_FINITE, OK

Floats = NDArray[np.float64]

# Default of Baumgarte's time constant, in steps. Explicit methods are stable above half a step.
BAUMGARTE_STEPS = 10
# Largest entry of R R^T - 1 that `set_state` accepts.
NO_ROTATION = 1e-6
METHOD = "rkmk4"  # default
ENGINES: weakref.WeakSet["Engine"] = weakref.WeakSet()  # of this process, for `halt_all`
ENDING = threading.Event()  # the process ends: a halt stays, also one that came before an `advance` began
# Number of steps per call of a kernel at first, and range of the wall time in s of later calls.
FIRST_BLOCK, QUICK, SLOW = 16, 0.01, 0.03


def _next_block(steps, seconds):
    """Number of steps for the next call of a kernel, after `steps` took `seconds`."""
    if seconds < QUICK:
        return 2 * steps
    return max(1, steps // 2) if seconds > SLOW else steps


def halt_all():
    """Halt the engines of all threads: a signal has come, which Python handles only between two calls of kernels."""
    ENDING.set()
    for engine in tuple(ENGINES):
        engine.halt()


def _stabilised(model, kind, constant, step):
    """Enable a stabilisation in a model. Raises ValueError for an invalid option."""
    SETTINGS["stabilisation"].check(kind)
    if constant is None:
        constant = BAUMGARTE_STEPS * step
    elif kind != "baumgarte":
        raise ValueError(f"baumgarte_time requires stabilisation 'baumgarte', got {kind!r}")
    if not (is_finite(constant) and constant >= step):
        raise ValueError(
            f"baumgarte_time must be a number of seconds and at least one step ({step:g} s), {got(constant)}"
        )
    return model.replace(projects=kind == "projection", baumgarte_rate=1.0 / constant if kind == "baumgarte" else 0.0)


class Engine:
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
    options: dexpinv, space, rtol, atol, rho_inf, if the method has them: see settings.SETTINGS
    quiet    : True: log no warnings
    layout   : of the scene, if it was made before
    Raises SceneError for a scene that cannot be simulated, ValueError for an invalid option or a
    method that cannot integrate the scene.

    inputs : Inputs, the commands that act
    events : JointEvents, of stops and dry friction

    The integration has reached a base: the end of a step, or a change of the inputs within one. An Engine stands there
    or later, `now`: within that step or, with a method that runs ahead, as far as that has come. The state there is a
    function of what was integrated, and computed when it is first asked for; the run does not depend on that.

    Orders: test/verification/test_orders.py; constraint residuals: test_heavy_top.py.
    """

    MOTION: tuple[str, ...] = ("_pose", "_twist", "_steps", "_offsets", "_angles", "_memory", "_modes")
    KEPT: tuple[str, ...] = (*MOTION, "inputs")
    LOCATES = False  # whether steps without error control, too, end where a law jumps

    apply_wrench = method_of("inputs", Inputs.apply_wrench)
    apply_effort = method_of("inputs", Inputs.apply_effort)
    pull = method_of("inputs", Inputs.pull)
    command_servo = method_of("inputs", Inputs.command_servo)
    command_motion = method_of("inputs", Inputs.command_motion)
    check_motion = method_of("inputs", Inputs.check_motion)
    check_jump = method_of("inputs", Inputs.check_jump)
    clear_wrenches = method_of("inputs", Inputs.clear_wrenches)
    drain_applied = method_of("inputs", Inputs.drain_applied)
    commanded_motions = property_of("inputs", Inputs.commanded_motions)
    input_count = property_of("inputs", Inputs.input_count)
    wrench_sources = property_of("inputs", Inputs.wrench_sources)
    drain_events = method_of("events", JointEvents.drain_events)
    drain_impacts = method_of("events", JointEvents.drain_impacts)
    drain_instants = method_of("events", JointEvents.drain_instants)
    event_count = property_of("events", JointEvents.event_count)
    place = place

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
        self.scene, self.method, self.step = scene, SETTINGS["method"].check(method), checked("step", step)
        check_group(method, group)
        self.options = check_options(method, options)
        layout = make_layout(scene) if layout is None else layout
        self.layout = layout.with_model(_stabilised(layout.model, stabilisation, baumgarte_time, self.step))
        self.stabilisation, self.baumgarte_time = stabilisation, baumgarte_time and float(baumgarte_time)
        self.group = choose_group(method, group)
        options = self.options | {"locates": self.LOCATES}
        self._integrator = make_integrator(method, self.layout, self.group, self.step, options)
        self._work = self._integrator.work
        self._switching = getattr(self._integrator, "switching", None)
        self._stop_at = getattr(self._integrator, "stop_at", None)
        self._work.clock.step_size[0], self._limited, self._held = self.step, False, None
        self._prepared = self._served = -1  # changes of the inputs at the last integration, and steps that it passed
        self._grid, self._warnings = StepGrid(self.step), Warnings(quiet)
        arrays = self._work.targets, self._work.motions
        self.inputs = Inputs(self.layout, self._grid, *arrays, self, self._warnings.late)
        self.events = JointEvents(self.layout, self._switching)
        self._controls = Controls(self._grid)
        self._sampling = Sampling(self.layout, self._grid, self._switching is not None)
        self._start = initial_state(self.layout.centred)
        self._block, self._halted = FIRST_BLOCK, False
        warm_up(self._touch)
        ENGINES.add(self)

    def __copy__(self) -> "Engine":
        return copy.deepcopy(self)  # a shallow copy would share the state

    def _touch(self):
        """Call every kernel once, so that no kernel is compiled during a run."""
        self.reset()
        self._integrate(self.now, self.step, 0, self.now)
        if self._switching is not None:
            self._switching.touch(self._pose, self._twist, self.inputs.acting.external)
            self.reset()
        sample = self.sample()
        return (
            sample.energy,
            sample.power,
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
        coordinates: ArrayLike | None = None,
    ) -> None:
        """Start again from a state at a step count: the method and the estimate of the error start anew.

        pose, twist : (n, 12), (n, 6) of frames at the centres of mass, as `state()` returns them
        angles : (k,) rad, `Sample.angles` of the state: unwrapped angles. None:
                 all are in (-pi, pi], as at the start of a scene
        coordinates : (s,) rad or m of the joints with stops or friction, to which their angles are
                 unwrapped: the fourth column of `Sample.switching`. None: near 0, as far as the stops allow
        steps  : 0 or more
        Clears the applied wrenches and efforts. The wrenches of the scene follow the step count.
        `snapshot` and `restore` continue a run exactly.
        Raises ValueError for wrong shapes, non-finite numbers, matrices that are not rotations, or an
        invalid step count.
        """
        n = len(self.layout.body_names)
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
        k, s = len(self._work.angle), len(self.layout.switches)
        if angles is not None:
            angles = finite(f"expected {k} finite angles, as `Sample.angles`", angles, (k,))
        if coordinates is not None:
            coordinates = finite(f"expected {s} finite coordinates of joints with stops or friction", coordinates, (s,))
        if not (is_count(steps) and steps < NEVER):
            raise ValueError(f"steps must be a whole number from 0 to {NEVER - 1}, {got(steps)}")
        self._start_at(pose, twist, self._grid.boundary(int(steps)), self.layout.angles(pose, angles))
        if angles is None:
            self._sample_laws()
        if self._switching is not None and coordinates is not None:
            self._switching.expect(coordinates)

    @property
    def base_ns(self):
        """Time in ns at which the integration is within a step; None: at the end of one."""
        return self._grid.mark(self.base) if self.base.offset else None

    def begin_at(self, time_ns):
        """Move a state that was set to a time in ns."""
        self.base = self.now = self._grid.marked(time_ns)
        self.inputs.clear(self.base)

    def _start_at(self, pose, twist, instant, angles):
        """Start again from a valid state at an Instant; the engine takes over its arrays."""
        self._work.angle[:] = angles
        self._work.report[LARGEST_TURN] = self._work.report[DEEPEST] = 0.0
        self._pose, self._twist = pose, twist
        self.base = self.now = instant
        self._here, self._served = None, -1
        self._controls.forget()
        self.inputs.clear(instant)
        self._integrator.restart()

    def start_from(self, other, instant=None):
        """Start again where another engine of the same scene stands, with its inputs.

        instant : of this engine, for the other one's base; None: at the same time
        """
        other.settle()
        same = self._grid.like(other._grid, other.base) if instant is None else instant
        self._start_at(other._pose.copy(), other._twist.copy(), same, other._work.angle)
        self._modes = other._modes
        self.inputs.commands = other.inputs.commands
        if instant is None:
            self.now = self._grid.like(other._grid, other.now)

    def take(self, commands, modes=None):
        """Continue from a state that was set with Commands, and modes of stops and friction as `encoded` gave them.

        Raises ValueError
        """
        self.inputs.commands = commands
        if self._modes and modes is not None:
            self._modes = decoded(modes, self._modes, "modes")

    @property
    def _angles(self):
        return self._work.angle

    @property
    def _memory(self):
        return self._integrator.memory

    @_memory.setter
    def _memory(self, memory):
        self._integrator.restart()
        self._remember(memory)

    def _remember(self, memory):
        self._served = self._prepared = -1
        for mine, array in zip(self._integrator.memory, memory):
            mine[...] = array

    @property
    def _modes(self):
        if self._switching is not None:
            self._switching.mark(self.inputs.acting.external)
        return self._mode_arrays

    @property
    def _mode_arrays(self):
        return () if self._switching is None else self._switching.memory

    @_modes.setter
    def _modes(self, modes):
        for mine, array in zip(self._mode_arrays, modes):
            mine[...] = array

    def restored(self):
        """Continue after `set_kept`."""
        if self._switching is not None:
            self._switching.restored(self.inputs.acting.external)

    @property
    def steps(self) -> int:
        """Number of whole steps since the start or the last reset."""
        return self.now.step

    @steps.setter
    def steps(self, steps):
        self.base = self.now = self._grid.boundary(steps)
        self._here = None

    _steps = property(lambda self: self.base.step, steps.fset)

    @property
    def _offsets(self):
        """Where the base and `now` are from the start of the base's step on: numerators and denominators."""
        grid = self._grid
        passed = [Fraction(grid.since(grid.boundary(self._steps), at)) for at in (self.base, self.now)]
        return passed[0].as_integer_ratio() + passed[1].as_integer_ratio()

    @_offsets.setter
    def _offsets(self, offsets):
        base, now = (Fraction(*offsets[k : k + 2]) if offsets[k + 1] else -1 for k in (0, 2))
        if not (self._grid.has(base) and base <= now):
            raise ValueError("the snapshot must have times within its step")
        self._stand(self._grid.at(self._steps, base), self._grid.at(self._steps, now))

    def state(self) -> tuple[Floats, Floats]:
        """Copies of the integrator's pose (n, 12) and twist (n, 6), for `set_state`.

        They refer to frames with the axes of the body frames and their origins at the centres of
        mass. They differ from those of `sample()` if a body has a `com` or an offset shape.
        Raises SimulationError if the state cannot be computed.
        """
        pose, twist, *_ = self.here()
        return pose.copy(), twist.copy()

    def at_bodies(self) -> tuple[Floats, Floats]:
        """Pose (n, 12) and twist (n, 6) of the body frames, read-only: possibly not copies."""
        return self.layout.offsets.to_bodies(*self.here()[:2])

    def snapshot(self) -> State:
        """Copy of the whole state, with the commands that act or start later, for `restore`."""
        self.settle()
        return State({}, kept(self))

    def restore(self, state: State) -> None:
        """Return to a snapshot. The continuation is bit-identical."""
        set_kept(self, state.parts)
        self._controls.forget()

    def settle(self):
        """Integrate as far as the present state needs, whether it was asked for or not: so equal states are equal."""
        with contextlib.suppress(SimulationError):  # raised when the state is asked for
            self._catch_up()
            self.here()
            if NOT_AHEAD < self.lead < self._grid.parts(self.now):
                self._integrator.forget()  # up to an event, whose time is earlier

    def _catch_up(self):
        """Move the base to the start of the present step, or to a change after it."""
        if self.base.step < self.now.step:
            now = self.now
            self._integrate_to(self._grid.boundary(now.step))
            self._stand(self.base, now)

    @property
    def time(self) -> float:
        """Simulated time since the start or the last reset, s."""
        return self.now.time

    @property
    def time_ns(self) -> int:
        """Simulated time in integer nanoseconds."""
        return self._grid.time_ns(self.now)

    def step_ns(self, steps):
        """Time in integer nanoseconds of a step count."""
        return self._grid.time_ns(self._grid.boundary(steps))

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

    @property
    def runs_ahead(self):
        """Whether substeps are as long as the motion allows."""
        return getattr(self._integrator, "runs_ahead", False)

    def covers_step(self, steps):
        """Whether the integration has reached a step count already."""
        return self._has_reached(self._grid.boundary(steps))

    def _has_reached(self, instant):
        """Whether a method that runs ahead has come to an Instant with the inputs that act now."""
        return self._prepared == self.inputs.changes and self.lead >= self._grid.parts(instant)

    @property
    def lead(self):
        """(whole steps, s after them) to which a method has run ahead."""
        return getattr(self._integrator, "lead", NOT_AHEAD)

    def limit_substeps(self, longest, longer=0.0):
        """Set the longest substep in s of a method with error control; call it at the start.

        longer : of a companion with given tolerances, ratio of its substeps to those of the simulation
        """
        self._integrator.limit(longest, longer)

    def choose(self, number):
        """Continue with another of the integrator's methods, by its number."""
        self.settle()
        self._integrator.choose(number)
        self._served = -1

    def halt(self) -> None:
        """End an `advance` of another thread after its last valid step, within a few ms."""
        self._halted = True
        if METHODS[self.method].controlled:  # a step may have 100 000 substeps
            self._integrator.limit_attempts(0)

    @property
    def is_halted(self) -> bool:
        """Whether `halt` was called since the last `advance` began."""
        return self._halted

    def end_halt(self) -> None:
        """Allow all again after `halt`, once the thread that advanced has ended; `advance` does so, too."""
        self._halted = False
        if METHODS[self.method].controlled:
            self._integrator.limit_attempts()

    def __repr__(self) -> str:
        name, method, bodies = type(self).__name__, self.method, len(self.layout.body_names)
        return f"{name}({self.scene.name!r}, bodies: {bodies}, {method}, t = {self.time:.9g} s, step {self.steps})"

    def advance(self, steps: int = 1, enough: Callable[[], bool] | None = None) -> None:
        """Advance to the end of the `steps`-th step from the present one on, an integer >= 0.

        enough : called about every 20 ms of wall time, or after each step that takes longer; if it returns
                 True, no more steps are taken

        Python handles signals equally often, so that Ctrl-C ends a call. Raises ValueError for other numbers.
        Raises SimulationError if the integration cannot continue: NaN or overflow, a rotation of nearly
        2 pi in a step, constraints that cannot be satisfied, an implicit step without solution, an
        unreachable tolerance. The state is then the last valid one.
        """
        if not is_count(steps):
            raise ValueError(f"steps must be a whole number, 0 or more, {got(steps)}")
        self.reach(self._grid.boundary(self.steps + int(steps)), enough)

    def advance_to(self, time: float) -> None:
        """Advance to a time in s: the state, samples and commands without a start are those of this time.

        Raises ValueError for a time before the present one, and SimulationError, as `advance`.
        """
        self.reach(self._instant(time))

    def reach(self, instant, enough=None):
        """As `advance_to`, of an Instant; enough : as in `advance`."""
        if ENDING.is_set():
            self.halt()
        elif self._halted:
            self.end_halt()
        if instant.step >= NEVER:
            raise ValueError(f"a run has {NEVER - 1} steps at most: take a larger step than {self.step:g} s")
        if instant == self.now and not instant < self.inputs.schedule.next:
            self._catch_up()
            if instant == self.base:
                self.inputs.update(instant)
        while self._controls and self.now < instant:
            stop = min(self._controls.call(self), instant)
            self._go(stop, enough)
            if self.now < stop or stop < instant and enough is not None and enough():
                return
        self._go(instant, enough)

    def control(self, function: Callable[[Any], Any], period: float) -> None:
        """Call a function of this simulation at all multiples of a period in s, from the present time on.

        It is called when the run goes on from this time, which is exact, with the state of this time. It reads `sample`
        and gives commands, such as `apply_effort` or `command_servo`, which act from this time on until the next ones.
        They are logged, recorded and repeated as all commands are: a replay needs no controller. Controllers are called
        in the order in which they were added; what they remember is no part of a snapshot, and `sample` of a later time
        does not call them. Raises ValueError.
        """
        self._controls.add(function, period)

    def _instant(self, time):
        """Instant of a time in s that is not before the present one. Raises ValueError."""
        if not (is_finite(time) and time <= LATEST):
            raise ValueError(f"a time must be a number of seconds, {LATEST:g} at most, {got(time)}")
        return self._valid(self._grid.instant(float(time)))

    def _valid(self, instant):
        """An Instant that is not before the present one. Raises ValueError."""
        if instant < self.now:
            raise ValueError(f"the time {instant.time:.9g} s is before the present one, {self.time:.9g} s")
        return instant

    def serves(self, step):
        """Whether the integration has passed a step, and no input changes up to its end."""
        return step < self._served and self._prepared == self.inputs.changes

    def _go(self, until, enough=None):
        """Advance to an Instant; nothing is done for an earlier one."""
        if until > self.now and self.serves(until.step):
            self.now, self._here = until, None
        elif until > self.now:
            self._integrate_to(until, enough)

    def _integrate_to(self, until, enough=None):
        """Advance in whole steps and, between changes of the inputs within them, in parts of steps."""
        self._warnings.begin()
        while self.base < until:
            stop, steps, changed = self._next_stop(until)
            if stop is None:
                self._stand(self.base, until)
                break
            began = time.perf_counter() if steps == self._block else 0.0
            done, status = self._take(stop, steps)
            if done:
                base = stop if done >= steps else self._grid.boundary(self.base.step + done)
                self._stand(base, max(base, self.now))
                self._sample_laws()
            if status == OK:
                if changed:
                    self.inputs.apply(stop, changed)
                if self.base >= until:
                    break
            elif changed:  # what was to act from the stop on does not act
                self.inputs.give_back(self._held)
            if self._halted:
                return
            self._checked(status)
            self._warnings.give(self)
            if began:
                self._block = _next_block(done, time.perf_counter() - began)
            if enough is not None and not self.base.offset and enough():
                break
        self._warnings.give(self)

    def fall_back(self):
        """Stand at the last state that was integrated: that of the present time, in the next step, cannot be."""
        self.now, self._here = self.base, None

    def _stand(self, base, now):
        """Move the base and the present time."""
        if (base, now) != (self.base, self.now):
            self.base, self.now, self._here = base, now, None
            if not base < self.inputs.schedule.next_of_scene:
                self.inputs.update(base)

    def _sample_laws(self):
        """Evaluate the sampled laws that are due at the base, and let their delayed outputs start."""
        if self._sampling and self._sampling.has(self.base):
            undefined = self._sampling.meet(self.base, self._work.angle, self._pose, self._twist)
            self.inputs.changes += 1
            if undefined:
                raise SimulationError(f"stopped at t = {self.time:.9g} s: {undefined}", NOT_FINITE)

    def _next_stop(self, until):
        """(Instant up to which the inputs that act now stay as they are, whole steps to it, their changes there).

        (None, 0, ()) : `until` is before the next one. 0 steps : a part of a step
        """
        base, grid, schedule = self.base, self._grid, self.inputs.schedule
        self.inputs.update(base)
        sampled = self._sampled_after(base)
        if self._switching is None and self.runs_ahead:
            stop, longest = min(schedule.next_after(base), sampled, until), base.step + self._block
            if stop == until or stop.step >= longest:
                stop = grid.boundary(min(stop.step, longest))
            return (stop, stop.step - base.step + (stop.offset > 0), ()) if stop > base else (None, 0, ())
        change, inside = NEVER, ()
        if schedule:
            change, inside = schedule.next_change(base.step), schedule.inside(base.step)
        if sampled.step == base.step:
            inside = sorted({*inside, sampled})
        elif sampled is not AFTER:
            change = min(change, sampled.step)
        self._held = self.inputs.held() if inside else None
        for instant in inside:
            # A part ends only where a total changes.
            if base < instant < until:
                if (changed := schedule.update(instant)) or instant == sampled:
                    return instant, 0, changed
                self.inputs.apply(instant, ())
        steps = min(until.step, base.step + 1 if inside or base.offset else change) - base.step
        if steps == 0:
            return None, 0, ()
        steps = min(steps, self._block)
        return grid.boundary(base.step + steps), 0 if base.offset else steps, ()

    def _take(self, stop, steps):
        """Integrate to the next stop, in whole steps, 0: in a part of one; returns (done, 1: the part, status)."""
        if steps:
            return self._integrate(self.base, self.step, steps, stop)
        good = self._pose.copy(), self._twist.copy(), self._work.angle.copy()
        parts = self.events.parts
        _, status = self._integrate(self.base, self._grid.between(self.base, stop) / parts, parts, stop)
        if status != OK:
            self._pose[:], self._twist[:], self._work.angle[:] = good
            self._integrator.restart()
        return int(status == OK), status

    def here(self):
        """(pose, twist, angles, modes or None: the present ones) at the present time, not to be changed.

        Raises SimulationError if the state cannot be computed.
        """
        if self.now == self.base:
            return self._pose, self._twist, self._work.angle, None
        if self._here is None:
            self._here = found = self._inside() or self._interpolated() or self._stepped()
            if self._sampling and self._sampling.has(self.now):
                self._sampling.meet(self.now, found[2], *found[:2])
        return self._here

    def _inside(self):
        """`here` from the last substep; None: the integration has not come to the present time."""
        if not (self.serves(self.now.step) or self._has_reached(self.now)):
            return None
        work, pose, twist = self._work, self._pose.copy(), self._twist.copy()
        clock, angles, modes = work.clock, work.angle.copy(), [array.copy() for array in self._mode_arrays]
        clock.to_step[0], clock.until[0] = self._grid.parts(self.now)
        status = self._integrator.inside(pose, twist, self.inputs.acting.external)
        found = pose, twist, work.angle.copy(), self._switching and self._switching.present_modes()
        work.angle[:], self._modes = angles, modes
        self._checked(status)
        return found

    def _interpolated(self):
        """`here` from the integration that runs ahead, up to the present time; None: not from it, as near an event."""
        if not self.runs_ahead:
            return None
        base, now, integrator, external = self.base, self.now, self._integrator, self.inputs.acting.external
        pose, twist, angles = self._pose.copy(), self._twist.copy(), self._work.angle.copy()
        h, modes = self._grid.between(base, now), [array.copy() for array in self._mode_arrays]
        self._prepare(base, h, now)
        memory, spent = [array.copy() for array in integrator.memory], integrator.spent
        _, status = integrator.look_ahead(h, pose, twist, external)
        self._note_lead()
        found = pose, twist, self._work.angle.copy(), self._switching and self._switching.present_modes()
        self._work.angle[:], self._modes = angles, modes
        if status == OK:
            return found
        if status != EVENT:  # the run will meet what was met here
            integrator.clear()
            self._remember(memory)
            integrator.spent = spent
        return None

    def _stepped(self):
        """`here` by a step of this size from the base, which is not taken."""
        with self._aside(Engine.MOTION):
            parts = self.events.parts if self.base.offset else 1
            h = self._grid.between(self.base, self.now) / parts
            self._checked(self._integrate(self.base, h, parts, self.now)[1])
            modes = None if self._switching is None else self._modes_now()
            return self._pose.copy(), self._twist.copy(), self._work.angle.copy(), modes

    @contextlib.contextmanager
    def _aside(self, parts=None):
        """Return to the present state afterwards, with all that was logged and counted; parts : of KEPT, None: all."""
        inputs, switching = self.inputs, self._switching
        before, held, stood = kept(self, parts), inputs.held(), (self.base, self.now, self._here)
        log, inputs.log = inputs.log, None
        spent = getattr(self._integrator, "spent", None)
        events = None if switching is None else switching.log()
        try:
            yield
        finally:
            if spent is not None:
                self._integrator.spent = spent
            set_kept(self, before)
            self.base, self.now, self._here = stood
            inputs.give_back(held)
            inputs.log = log
            if events is not None:
                switching.take_log(events)

    def _sampled_after(self, instant):
        """First Instant after one at which a sampled law changes what it holds."""
        return self._sampling.after(instant) if self._sampling else AFTER

    def changes_before(self, steps):
        """Whether an input changes after the present time and before a step count."""
        change = min(self.inputs.schedule.next_after(self.now), self._sampled_after(self.now))
        return change < self._grid.boundary(steps)

    def instant_inside(self, step, part):
        """Instant of an exact fraction of a step."""
        return self._grid.inside(step, part)

    def instant_of(self, time_ns):
        """Instant of a time in whole ns."""
        return self._grid.marked(time_ns)

    def _checked(self, status):
        if status != OK:
            raise SimulationError(explain(self, status), status & 0xFF)

    def _integrate(self, start, h, steps, end):
        """Take steps of size h from an Instant to another, between which no wrench changes.

        returns (steps done, status)
        """
        self._prepare(start, h, end)
        found = self._integrator.advance(h, steps, self._pose, self._twist, self.inputs.acting.external)
        self._note_lead()
        return found

    def _note_lead(self):
        self._served = min(self.lead[0], self.inputs.schedule.next.step, self._sampled_after(self.base).step)

    def _prepare(self, start, h, end):
        """Set the times of steps of size h from an Instant to another."""
        clock, whole = self._work.clock, h == self.step and not start.offset
        self._set_clock(start, start.step if whole else None)
        self._prepared, self._served = self.inputs.changes, -1
        self._work.registers[WITNESS, 0] = 0.0
        clock.from_step[0], clock.since[0] = self._grid.parts(start)
        clock.to_step[0], clock.until[0] = self._grid.parts(end)
        if self._stop_at is not None:
            known = min(self.inputs.known_end, self._sampled_after(start))
            if known is not AFTER or self._limited:
                self._stop_at(self._grid, start, known)
                self._limited = known is not AFTER

    def _set_clock(self, start, steps=None):
        """Set the time of the next step to an Instant; steps : those before it, if whole steps begin there."""
        clock, time = self._work.clock, start.time
        if self._sampling.holds:
            self._work.targets[-1, 0] = self._sampling.last(start)  # modes and methods see other inputs
        clock.count[0], clock.offset[0], clock.now[0] = (0.0, time, time) if steps is None else (steps, 0.0, time)

    def act_from(self, instant):
        """Let what acts from an Instant on act, and set the time: the engine does not move there."""
        if instant < self.inputs.schedule.reached:
            self.inputs.set_commands(self.inputs.commands, instant)
        self.inputs.update(instant)
        self._set_clock(instant)

    def sample(self, time: float | None = None) -> Sample:
        """Create a Sample of the present state, or of a later one.

        time : s, rounded to whole ns; None: the present one. A later one is that of a copy that advances there

        The state within a step is that of a step of this size, of the method's order; of a simulation to an accuracy it
        is an interpolant in the algebra, of order 7 for rkmk853 and 3 for radau5. The run does not depend on it.
        Raises ValueError for an earlier time, and SimulationError if the state cannot be computed.
        """
        instant = self.now if time is None else self._instant(time)
        if instant == self.now:
            return self._sample()
        with self._aside():
            self._go(instant)
            return self.sample()

    def samples(self, times: ArrayLike) -> Iterator[Sample]:
        """Advance through times in s that do not decrease, and yield a Sample at each of them.

        Raises ValueError for other times and SimulationError, as `advance_to`.
        """
        what = "times must be finite numbers in one row that do not decrease"
        times = np.atleast_1d(floats(what, times))
        if times.ndim != 1 or not np.isfinite(times).all() or (np.diff(times) < 0.0).any():
            raise ValueError(f"{what}, {got(times)}")
        for at in times[[0, -1]].tolist() if len(times) else ():
            self._instant(at)
        return self._samples(times.tolist())

    def _samples(self, times):
        for at in times:
            self.advance_to(at)
            yield self.sample()

    def _sample(self):
        pose, twist, angles, modes = self.here()
        sample = Sample(self.layout, self.time, self.time_ns, self.steps, pose.copy(), twist.copy(), angles.copy())
        if self.inputs.schedule:
            sample.acting = self.inputs.acting.copy()
            sample.joint_efforts = self.inputs.schedule.efforts
        if self._switching is not None:
            sample.switching = self._modes_now() if modes is None else modes
        return sample

    @property
    def modes(self) -> dict[str, str]:
        """As Sample.modes."""
        return self.sample().modes

    def _modes_now(self):
        """(k, 5) modes of the joints with stops or friction, see Sample.switching."""
        self._set_clock(self.base)
        return self._switching.modes(self.base.time, (self._pose, self._twist, self.inputs.acting.external))

    def reaction_array(self, out: Floats | None = None) -> Floats:
        """Reactions of all joints of the state that `sample` gives, bit-identical to those of the Sample.

        out : (J, 6) array, of any memory layout, that takes them; None: a new one
        returns (J, 6) torque N m, force N of the joints in the order of the scene; see
        Sample.reactions. Raises SimulationError if they cannot be computed.
        """
        reactions = self.layout.reactions
        if not reactions.names:
            return self._given(np.empty((0, 6)), out)
        if self.now != self.base:
            return self._given(self.sample().reaction_array, out)
        found = reactions.empty()
        if reactions.has_inputs:
            reactions.take(*self._inputs_now())
        if reactions.present(self._pose, self._twist, self.inputs.acting.external, found) != REGULAR:
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
            if not self.layout.reactions.take_modes(*self._integrator.mechanism):
                modes = self._modes_now()
        return work.angle, self.inputs.acting, modes, self.time

    def energy(self) -> float:
        """Kinetic energy plus potential energy of gravity and springs of the state that `sample` gives, J."""
        return self.sample().energy
