# SPDX-License-Identifier: Apache-2.0
"""Simulation of a scene to an accuracy, or with a given method and step; it estimates its error."""

import functools
import logging
import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

from numpy.typing import ArrayLike

from liegroup_core.accuracy import METHOD, AccuracyControl
from liegroup_core.engine import Engine
from liegroup_core.errors import SimulationError
from liegroup_core.fields.arguments import got
from liegroup_core.forces.instants import NEVER
from liegroup_core.layout import make_layout
from liegroup_core.methods.families import choose_group
from liegroup_core.parts import attached
from liegroup_core.running_error import LOST, RunningError
from liegroup_core.scene.description import Scene
from liegroup_core.settings import SETTINGS, check_group, checked, of_engine
from liegroup_core.state import State, decoded, empty, encoded, kept, set_kept, with_pulls
from liegroup_core.stiffness import MethodChoice

log = logging.getLogger("liegroup_core")

# Possible steps of a simulation to an accuracy, s: the longest that is at most PART of the horizon.
STEPS = tuple(float(f"{digit}e{power}") for power in range(-3, -8, -1) for digit in (10, 5, 2))
PART = 0.02


class Simulation(Engine):
    """Mechanism that is integrated on its Lie group, to an accuracy or with a given method and step.

    Without a method, the tolerance of the steps follows the estimated error (accuracy.py), and `method`
    is the cheaper one of an explicit and an implicit method (stiffness.py):

    accuracy : largest error of a pose in the first `horizon` seconds, relative to the mechanism's size,
               or in rad; the error may grow by as much in each further horizon. Default 1e-4
    horizon  : s, at most 1e6; default 60
    step     : s, interval of `advance`, which does not limit the substeps. Default: 10 ms, at most 1/50 of the horizon
    stabilisation : default "projection" for joints that would drift, else "none"

    With a method, it takes the arguments of Engine, with their defaults.

    estimate : True: carry a running estimate of the global error (running_error.py), at about 1.8
               times the cost: `sample().error`, `predictable_until`. An accuracy requires it
    quiet    : True: log no warnings

    Raises SceneError for a scene that cannot be simulated, ValueError for a wrong option or a
    method that does not fit the scene.
    """

    _warned = False
    _lost = ""
    _running: RunningError | None = None
    _control: AccuracyControl | None = None
    _choice: MethodChoice | None = None

    def __init__(
        self,
        scene: Scene,
        method: str | None = None,
        step: float | None = None,
        group: str = "auto",
        stabilisation: str | None = None,
        baumgarte_time: float | None = None,
        accuracy: float | None = None,
        horizon: float | None = None,
        estimate: bool = True,
        quiet: bool = False,
        **options: Any,
    ) -> None:
        self._quiet = quiet
        if method is not None and (accuracy, horizon) != (None, None):
            raise ValueError("give either an accuracy or a method: an accuracy selects the method itself")
        SETTINGS["estimate"].check(estimate)
        if method is not None or not isinstance(scene, Scene):
            stabilisation = "none" if stabilisation is None else stabilisation
            super().__init__(scene, method, step, group, stabilisation, baumgarte_time, quiet, **options)
            self._running = RunningError(self) if estimate else None
            self._keep()
            return
        accuracy, horizon = checked("accuracy", accuracy), checked("horizon", horizon)
        if not estimate:
            raise ValueError("an accuracy requires the error estimate: enable it, or give a method")
        for name in {"rtol", "atol"} & options.keys():
            raise ValueError(f"an accuracy sets {name}; remove it, or give a method")
        check_group(METHOD, group)
        tolerances = {"rtol": accuracy, "atol": accuracy} | options
        layout = make_layout(scene)
        group = choose_group(METHOD, group)
        if stabilisation is None:
            stabilisation = "projection" if layout.drifts(group) else "none"
        step = default_steps(horizon)[0] if step is None else step
        super().__init__(scene, METHOD, step, group, stabilisation, baumgarte_time, quiet, layout, **tolerances)
        self._running = RunningError(self, horizon)
        self._choice = MethodChoice(self._running)
        self._control = AccuracyControl(accuracy, horizon, self._tighten)
        self._keep()

    def _keep(self):
        """Name the parts of the state; the choice of the method refers to the state of both engines."""
        parts = ("_running", "_choice", "_control")
        given = tuple(part for part in parts if getattr(self, part) is not None)
        self.KEPT = (*Engine.KEPT, *(("_warned", "_lost") if given else ()), *given)

    def _tighten(self, part):
        for integrator in self._running.integrators:
            integrator.tighten(part)

    @property
    def arguments(self) -> dict[str, Any]:
        """Arguments besides the scene that create the same simulation, as JSON types."""
        common = of_engine(self)
        if self._control is None:
            without = {} if self._running is not None else {"estimate": False}
            return {"method": self.method, **common, **self.options, **without}
        options = {key: self.options[key] for key in self.options.keys() - {"rtol", "atol"}}
        chosen = {"accuracy": self._control.given, "horizon": self._control.horizon}
        return chosen | common | options

    @property
    def promise(self) -> dict[str, float] | None:
        """Accuracy, horizon in s, and the mechanism's size in m; None with a method."""
        if self._control is None:
            return None
        return {"accuracy": self._control.accuracy, "horizon": self._control.horizon, "length": self._running.size}

    @property
    def accuracy(self) -> float | None:
        """Present accuracy, see `set_accuracy`; None with a method."""
        return None if self._control is None else self._control.accuracy

    @accuracy.setter
    def accuracy(self, accuracy):
        raise AttributeError("use `set_accuracy` to change the accuracy")

    def set_accuracy(self, accuracy: float) -> None:
        """Continue with another accuracy, until the state is set. Raises ValueError.

        If the estimated error also exceeds this one, `accurate_until` does not change.
        """
        if self._control is None:
            raise ValueError("`set_accuracy` needs a simulation made with an accuracy; this one has a method")
        accuracy = SETTINGS["accuracy"].check(accuracy)
        self.settle()  # tolerances change at this time, however far the two have come
        self._running.meet()
        self._control.change(accuracy, self.time, self.largest_error)
        self._warned &= self.accurate_until <= self.time

    @property
    def doubt(self) -> str | None:
        """Message stating when the estimated error exceeded the accuracy, or became large; None if never.

        It is also logged.
        """
        return "; ".join(filter(None, (self._excess, self._lost))) or None

    @property
    def _excess(self):
        if not self.accurate_until < math.inf:
            return None
        found, reason = self._control.found, self.inaccurate_because
        what = f", above the accuracy of {self.exceeded:.2g}{reason and f': {reason}'}"
        return self._text(found["time"], found["error"], what)

    @property
    def accurate_until(self) -> float:
        """Last simulated time in s at which the estimated error did not exceed the accuracy then; inf: always.

        NaN with a method.
        """
        return math.nan if self._control is None else self._control.ended

    @property
    def exceeded(self):
        """The accuracy that the estimated error exceeded first, grown with the horizons; NaN if none."""
        return math.nan if self._control is None else self._control.found["wanted"]

    @property
    def inaccurate_because(self) -> str:
        """Why `accurate_until` is finite, and what can be done; empty if it is infinite or the reason unknown."""
        return "" if self._control is None else self._control.reason

    @property
    def largest_error(self) -> float:
        """Present estimated error of the worst pose, relative to the mechanism's size or in rad.

        NaN without an estimate, and before `estimated_from`.
        """
        return math.nan if self._running is None else self._running.largest

    @property
    def estimated_from(self) -> float:
        """Simulated time in s of the first estimate of the error since the state was set; NaN without one."""
        return math.nan if self._running is None else self._running.first_step * self.step

    @property
    def predictable_until(self) -> float:
        """Simulated time in s of the last checkpoint before the estimated error became large; inf: not yet.

        Large: a tenth of the mechanism's size, or 0.1 rad. NaN without an estimate.
        """
        return math.nan if self._running is None else self._running.estimate.predictable_until

    def _sample(self):
        """As Engine._sample, with the estimated errors if they are carried."""
        sample = super()._sample()
        if self._running is not None:
            sample.errors = self._running.errors()
        if self._control is not None:
            wanted = self._control.wanted(sample.time)
            sample.bound = wanted * self._running.size, wanted
        return sample

    @functools.cached_property
    def _identity(self):
        """Properties that a snapshot must share with the simulation that restores it."""
        return {"scene": self.scene.text, **self.arguments}

    def snapshot(self) -> State:
        """Copy of the whole state, for `restore`: commands, error estimate and control of the steps included.

        A State is a value: it can be held, copied, compared and pickled.
        """
        self.settle()
        if self._running is not None:
            self._running.meet()
        return State(self._identity, kept(self))

    def restore(self, state: State) -> None:
        """Return to a snapshot of this simulation, or of another one of the same scene with the same arguments.

        The continuation is bit-identical. Raises ValueError for anything else; the state is then unchanged.
        """
        if not isinstance(state, State):
            raise ValueError(f"expected what `snapshot` of this simulation returned, {got(state)}")
        mine, theirs = self._identity, state.identity
        for what in (*mine, *theirs):
            if mine.get(what) != theirs.get(what):
                values = "" if what == "scene" else f", {theirs.get(what)!r} instead of {mine.get(what)!r}"
                raise ValueError(f"the snapshot is of a simulation with another {what}{values}")
        if state.parts.keys() != kept(self).keys():
            raise ValueError("the snapshot must have the parts of this simulation")
        self._restore(encoded(state.parts))

    def restore_parts(self, data):
        """Continue from the parts of a State as JSON types. Raises ValueError; the state is then unchanged.

        The time within the step may be missing, and with a method the estimate of the error.
        """
        self._restore(self._with_offsets(data))

    def _restore(self, data):
        before = kept(self)
        needed = before if self._control is not None else kept(self, Engine.KEPT)
        like = {name: part for name, part in before.items() if name in needed or name in data}
        parts = decoded({name: data[name] for name in like if name in data}, like, "the snapshot")
        if not 0 <= parts["steps"] < NEVER:
            raise ValueError(f"the snapshot must have a number of steps from 0 to {NEVER - 1}, {got(parts['steps'])}")
        self._controls.forget()
        try:
            set_kept(self, parts)
        except ValueError:  # a command to an unknown body or joint
            set_kept(self, before)
            raise

    def _with_offsets(self, data):
        """Parts of a State as JSON types.

        From earlier versions they have a mask of the wrenches of the scene in the memory of a method, and those without
        offsets the time in ns, and no Jacobians; none has pulls, or the cause of an infinite estimate.
        """

        def complete(parts, now_ns):
            if not isinstance(parts, dict):
                return parts
            memory, given = self._integrator.memory, parts.get("memory")
            whole = "offsets" in parts
            if isinstance(given, list) and (not whole or len(given) == len(memory) + 1):
                mask = getattr(self._integrator, "mask_before", None) or len(given)
                given = given[:mask] + given[mask + 1 :]
                given += encoded([empty(array) for array in memory[len(given) :]])
                parts = parts | {"memory": given}
            if isinstance(given, list):
                parts = parts | {"memory": [with_pulls(*each) for each in zip(given, memory)] + given[len(memory) :]}
            if whole:
                return parts
            now = 0 if now_ns is None else self._grid.marked(now_ns).offset
            return parts | {"offsets": [0, 1, *Fraction(now).as_integer_ratio()]}

        if isinstance(data.get("running"), dict) and "companion" in data["running"]:
            running = {"lost": LOST} | data["running"]
            data = data | {"running": running | {"companion": complete(running["companion"], None)}}
        return complete(data, data.get("reached_ns"))

    def _start_at(self, pose, twist, instant, angles):
        super()._start_at(pose, twist, instant, angles)
        self._warned, self._lost = False, ""
        if self._running is not None:
            self._running.restart()
        if self._control is not None:
            self._choice.restart()
            self._control.restart(self.time)

    def sensitivities(self, names: Sequence[str], times: ArrayLike, outputs: Sequence[str] | None = None) -> Any:
        """Derivatives of the run from the start of its scene by numbers of the scene: linear.Sensitivities.

        names, times, outputs : of `linear.sensitivities`
        With a method the runs have this method and step, else an accuracy of 1e-12. Raises SceneError, SimulationError.
        """
        settings = {} if self.promise else self.arguments
        return attached("sensitivities")(self.scene, names, times, outputs, **settings)

    def view(self, **options: Any) -> Any:
        """Live page of a copy that continues from the present state; a notebook cell that ends with it displays it.

        options : those of `liegroup_sim_ros.live`, whose extra `view` is needed
        """
        return attached("view")(self, **options)

    def halt(self) -> None:
        """As Engine.halt."""
        super().halt()
        if self._running is not None:
            self._running.companion.halt()

    def end_halt(self) -> None:
        """As Engine.end_halt."""
        super().end_halt()
        if self._running is not None:
            self._running.companion.end_halt()

    def _go(self, until, enough=None):
        running = self._running
        if running is None or (until.step < running.calm_until and self.serves(until.step)):
            super()._go(until, enough)
            return
        if not running.begun:
            running.update()
        if self._choice is not None and until > self.now and self._choice.start():
            self._control.find_first(self.step, running.error_ahead)
        while self.steps < until.step:
            stop = running.next_stop(self.steps, until.step)
            self._go_on(self._grid.boundary(stop), enough)
            if self.steps < stop:
                return
            count = running.estimate.checkpoints
            running.update()
            if self._exceeded_between():
                running.make_checkpoint()
            if running.estimate.checkpoints > count:
                if self._control is not None:
                    predictable = running.estimate.predictable_until == math.inf
                    self._control.update(self.time, running.largest, predictable)
                    self._choice.update()
                self._look()
            if self.steps < until.step and (self._halted or (enough is not None and enough())):
                return
        if self.now < until:
            self._go_on(until, enough)

    def _go_on(self, until, enough):
        """Advance to an Instant; an implicit method that was chosen and fails is left for the explicit one."""
        try:
            super()._go(until, enough)
        except SimulationError:
            if self._choice is None or not self._choice.leave():
                raise
            super()._go(until, enough)

    def _exceeded_between(self):
        """Whether the estimate exceeds the accuracy for the first time, and between two checkpoints."""
        control, running = self._control, self._running
        if control is None or control.ended < math.inf or not running.looks:
            return False
        running.meet()
        return running.largest > control.wanted(self.time)

    def _look(self):
        """Warn once if the error exceeds the accuracy, and once if it is large."""
        time = self.time
        if not self._warned and self.accurate_until <= time:
            self._warned = True
            self._warn(self._excess)
        if not self._lost and self.predictable_until <= time:
            advice = "" if self._control else "; use a smaller step, or an accuracy"
            what = f": from here on the computed motion may differ completely from the true one{advice}"
            self._lost = self._text(time, self.largest_error, what)
            self._warn(self._lost)

    def _text(self, time, error, what):
        if error == math.inf:
            return f"at t = {time:.6g} s the error is no longer known, because {self._running.lost}{what}"
        return f"at t = {time:.6g} s the estimated error is {error:.2g} of the mechanism's size or rad{what}"

    def _warn(self, text):
        if not self._quiet:
            log.warning(text)


def default_steps(horizon):
    """Possible steps in s of a simulation to an accuracy, long to short; horizon : s."""
    return [step for step in STEPS if step <= PART * horizon] or STEPS[-1:]
