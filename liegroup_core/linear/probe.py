# SPDX-License-Identifier: Apache-2.0
"""Equations of motion near a state, in a chart of the configuration space.

The state of a simulation is X_0, V_0 on the product of the joints' motion groups. A neighbour is
X_0 exp(psi), V_0 + w with one number of each for every degree of freedom of the spanning tree. In these
coordinates y = (psi, w) the mechanism is the ordinary differential equation that Munthe-Kaas methods integrate,

    psi' = dexp^-1_{-psi} (V_0 + w) ,   w' = Vdot (X_0 exp psi, V_0 + w, inputs)

with the accelerations of the engine: loops, forces, couplings, driven joints, and the stops and friction that
hold at the state. For joints with one coordinate psi is the change of that coordinate.

If the motion slides along surfaces of laws, a neighbour keeps its distances from these: the shares of both sides are
those of the neighbour (dynamics/sliding.py). So they are functions of the state, inputs and numbers, and differences of
the accelerations have their derivatives.
"""

import contextlib
import dataclasses
import math

import numpy as np

from liegroup_core.compiling import SameTypes, Struct, borrowed, kernel
from liegroup_core.dynamics.coordinates import lift_links, place_links
from liegroup_core.dynamics.coupled_rows import set_gap
from liegroup_core.dynamics.loads import FOUND, find_loads, gather_lacking
from liegroup_core.dynamics.loops import project
from liegroup_core.dynamics.matrix import is_off
from liegroup_core.dynamics.state import leave
from liegroup_core.dynamics.switches import MOVES, modes_of, set_modes, set_rates
from liegroup_core.dynamics.trees import move_links
from liegroup_core.engine import METHOD, Engine
from liegroup_core.errors import SceneError, SimulationError
from liegroup_core.forces.formulas import OPEN, UNKNOWN
from liegroup_core.forces.law import branch_of, laws_of, places_of_branches, state_matters
from liegroup_core.joints.stops import SLIDE, TURN
from liegroup_core.methods.munthe_kaas import steps
from liegroup_core.methods.munthe_kaas.explicit import make_scheme
from liegroup_core.methods.table import EXACT, RELATIVE, Tableau
from liegroup_core.observables.sample import Sample
from liegroup_core.reports import explain
from liegroup_core.status import DEPENDENT_ROWS, NOT_FINITE, OK

from .differences import derivative
from .tangents import NOT_REGULAR, NOT_SMOOTH, tangents

ROUND_OFF = 64.0 * np.finfo(float).eps  # of the largest entry of a tangent
# Of one stage, whose displacement is its derivative.
_ONE = Tableau(np.zeros((1, 1)), np.ones(1), np.zeros(1), np.zeros((0, 2)))


@kernel
def _set_neighbour(model, work, scheme, y, pose_in, twist_in, external_in):
    """Set the stage to a neighbour y (f, 2) of a state. Returns (external, status)."""
    given = borrowed(pose_in), borrowed(twist_in), borrowed(external_in)
    pose, twist, external, _ = steps.enter(model, work, given[0], given[1], given[2])
    steps.begin(model, work, pose, twist)
    half = work.slopes.shape[1] // 2
    for r in range(len(y) // half):
        for c in range(half):
            work.slopes[r, c], work.slopes[r, half + c] = y[r * half + c, 0], y[r * half + c, 1]
    return external, steps.move(model, work, scheme, 1.0, 1, False, pose)


@kernel
def _accelerate(model, work, external):
    """Accelerations of the stage, and the loads of its friction. Returns a status."""
    dependent = steps.accelerate(model, work, external)
    if dependent >= 0:
        return DEPENDENT_ROWS + (dependent << 8)
    if model.has_loads:
        gather_lacking(model, work)
        find_loads(model, work)
    return OK


@kernel
def _evaluate(model, work, scheme, y, pose_in, twist_in, external_in, out, pose_out, twist_out):
    """Write y' (f, 2) at a neighbour, and poses and twists of the bodies there. Returns a status."""
    external, status = _set_neighbour(model, work, scheme, y, pose_in, twist_in, external_in)
    if status != OK:
        return status
    status = _accelerate(model, work, external)
    if status != OK:
        return status
    steps.store_slopes(model, work, scheme, 1)
    half = work.slopes.shape[1] // 2
    rows = len(y) // half
    for r in range(rows):
        for c in range(half):
            out[r * half + c, 0], out[r * half + c, 1] = work.slopes[rows + r, c], work.slopes[rows + r, half + c]
    steps.place(model, work, pose_out, twist_out)
    return OK


@kernel
def _close(model, work, scheme, y, pose_in, twist_in, external_in, rates_out, pose_out, twist_out):
    """Project a neighbour onto the cut joints: write its rates (f,), poses and twists. Returns a status."""
    _, status = _set_neighbour(model, work, scheme, y, pose_in, twist_in, external_in)
    if status == OK and len(model.cuts) > 0:
        status = project(model, work)
    if status != OK:
        return status
    n = len(model.bodies)
    for b in range(len(model.links)):
        link = model.links[b]
        for k in range(link["freedoms"]):
            rates_out[link["freedom"] + k] = work.stage_twist[n + b, k]
    steps.place(model, work, pose_out, twist_out)
    return OK


@kernel
def _gaps(model, work, scheme, y, pose_in, twist_in, external_in, gaps_out):
    """Write the position residuals (m,) of all rows that act at a neighbour. Returns a status."""
    _, status = _set_neighbour(model, work, scheme, y, pose_in, twist_in, external_in)
    if status != OK:
        return status
    move_links(model, work)
    place_links(model, work)
    lift_links(model, work)
    set_gap(model, work)
    for r in range(len(model.row_residual)):
        gaps_out[r] = 0.0 if is_off(model, work, r) else work.gap[model.row_residual[r]]
    return OK


def _structure(value):
    """Type, shapes and whole numbers of a model."""
    if isinstance(value, Struct):
        parts = (getattr(value, field.name) for field in dataclasses.fields(value))
        return type(value).__name__, *map(_structure, parts)
    if not isinstance(value, np.ndarray):
        return value if isinstance(value, (bool, int)) else None
    names = value.dtype.names
    if names:
        return value.shape, *(_structure(value[name]) for name in names)
    return value.shape, None if value.dtype.kind == "f" else value.tobytes()


@kernel
def _equations(model, work, pose, twist, external, own_pose, own_twist, out):
    """Write w' (f,), position residuals (m,) and J V (m,) at the links' rows of pose and twist. Returns a status."""
    external = steps.enter(model, work, borrowed(own_pose), borrowed(own_twist), borrowed(external))[2]
    steps.begin(model, work, pose, twist)
    status = _accelerate(model, work, external)
    if status != OK:
        return status
    f, m = len(work.freedoms), len(model.row_residual)
    for k in range(f):
        out[k] = work.acceleration[k, 0]
    if m == 0:
        return OK
    for r in range(m):
        out[f + m + r] = 0.0 if is_off(model, work, r) else work.slip[r]
    lift_links(model, work)
    set_gap(model, work)
    for r in range(m):
        out[f + r] = 0.0 if is_off(model, work, r) else work.gap[model.row_residual[r]]
    return OK


def refuse_sampled(described):
    """Raise SceneError for forces of a scene with a sampled law: a state has no derivatives by what was held before."""
    for law in laws_of(described):
        if law.period is not None:
            raise SceneError(
                f"the law {law.name} has a period: linear systems, trim, sensitivities, inverse dynamics and identify "
                "need laws without one; remove period, delay and update"
            )


def refuse_sliding(probe, what):
    """Raise SimulationError for a Probe at a state that slides along a comparison of a law; what : needs another."""
    laws = probe.layout.model.forces.laws
    for k in probe.slides:
        law = probe.layout.states[len(laws.held) + k].partition(".")[0]
        raise SimulationError(
            f"the motion slides along a comparison of the law {law} at t = {probe.base.time:.9g} s, {what} needs "
            "a state that does not: choose another time, or make the jump smooth, as 1 if v > 0 else -1 by tanh(v/0.01)"
        )


class _Still(Engine):
    """Engine that takes no step: kernels of steps and samples are not needed."""

    LOCATES = True

    def _touch(self):
        self.reset()

    def shares_at(self, pose, twist):
        """Branches of the surfaces of laws along which the motion slides from a state on, UNKNOWN for the others."""
        branches, surfaces = self._integrator.mechanism[1].branches, self.layout.model.forces.laws.surfaces
        branches[:] = UNKNOWN
        self._checked(self._switching.meet_surfaces((pose, twist, self.inputs.acting.external)))
        return np.where(branches[surfaces] > 1.0, branches[surfaces], UNKNOWN)


class Probe:
    """Neighbours of a state of a simulation, which does not change.

    simulation : Simulation or Engine
    time       : s, of a state within the present step; None: the present state
    in_space   : True: the freedoms of a planar mechanism are those of its joints in space, whatever its numbers
    acting     : Acting
    base       : Sample of the state
    layout     : Layout of the simulation
    Raises SimulationError where the accelerations of the state cannot be computed, SceneError for sampled laws.
    """

    def __init__(self, simulation, time=None, in_space=False):
        self.layout = simulation.layout.in_space if in_space else simulation.layout
        refuse_sampled(simulation.scene.forces)
        engine = _Still(simulation.scene, METHOD, simulation.step, RELATIVE, "none", quiet=True, layout=self.layout)
        self._engine = engine
        engine.start_from(simulation)
        self._model, self._work = engine._integrator.mechanism
        self._scheme = make_scheme(_ONE, EXACT)
        self.freedoms = len(self._work.freedoms)
        laws = self._model.space.forces.laws
        self._kept = places_of_branches(laws)
        self._held = UNKNOWN
        self._sides = laws.code[laws.kinks[laws.surfaces, 0], 2:4]
        self._zeros, self._equations = np.zeros((self.freedoms, 2)), SameTypes(_equations)
        self.take(simulation.sample(time))

    def take(self, sample):
        """Go to the state of a Sample of the simulation, with the inputs of its time."""
        self.base, engine = sample, self._engine
        if engine.layout.switches:
            set_modes(self._model, self._work, sample.switching)
        self._take_inputs()
        self.pose, self.twist = (array.copy() for array in sample._state)
        self._work.angle[:] = sample.angles
        if len(self._model.space.forces.laws.surfaces) and not self.slides.size:  # a start that rests on one
            self._work.angle[self._kept] = engine.shares_at(self.pose, self.twist)
        self._states = sample.angles[len(sample.angles) - len(self._model.law_links) :]
        self._shares = self._work.angle[self._kept].copy()
        self._work.known[0] = 0.0

    def _take_inputs(self, instant=None):
        engine = self._engine
        engine.act_from(engine.instant_of(self.base.time_ns) if instant is None else instant)
        self.acting = engine.inputs.acting.copy()

    def _meet(self, other):
        """Take the time, modes and angles of a Probe of a scene with other numbers."""
        if self.layout.switches:
            self.modes = other.modes
        if self.base.time_ns != other.base.time_ns:
            self.base = other.base
            self._take_inputs()
        self._work.angle[:] = other._work.angle

    def follow(self, other):
        """Take time, modes and the joints' coordinates and rates of a Probe of a scene with other numbers."""
        other.closed()
        self._meet(other)
        pose, twist = self.pose.copy(), self.twist.copy()
        leave(self._model, self._work, other._work.pose, other._work.twist, pose, twist)
        time, angles = other.base.time, self._work.angle.copy()
        self.base = base = Sample(
            self.layout, time, other.base.time_ns, other.base.steps, pose.copy(), twist.copy(), angles
        )
        self.pose, self.twist = pose, twist
        self._work.known[0] = 0.0
        base.acting, base.switching = self.acting, self.modes if self.layout.switches else None

    def has_structure_of(self, other):
        """Whether the model of another Probe differs in numbers only."""
        return _structure(self._model) == _structure(other._model)

    def go_to_time(self, time):
        """Set the time in s, at which wrenches of the scene and driven joints act."""
        self._take_inputs(self._engine._grid.instant(float(time)))

    @property
    def state_freedoms(self):
        """(s,) freedoms whose rates are the states of laws."""
        return self._model.links["freedom"][self._model.law_links]

    @property
    def acts(self):
        """(f,) whether anything depends on a freedom: not on a state whose readers the laws skip."""
        self.slopes()
        laws, registers = self._model.space.forces.laws, self._work.registers
        found = np.ones(self.freedoms, dtype=bool)
        found[self.state_freedoms] = [state_matters(laws, registers, s) for s in range(len(laws.states))]
        return found

    @property
    def held(self):
        """(f,) whether stops or friction hold a degree of freedom."""
        return self._work.held[: self.freedoms] != 0.0

    @property
    def slides(self):
        """(s,) numbers of the surfaces of laws along which the motion slides."""
        return np.flatnonzero(self._work.angle[self._kept] > 1.0)

    def heights(self, y=None):
        """(s,) distances a - b from these surfaces at a neighbour y (f, 2), in the units of their formulas."""
        self.slopes(y)
        above, below = self._work.registers[self._sides[self.slides], 0].T
        return above - below

    @contextlib.contextmanager
    def holding(self):
        """Let laws have the branches of the state, whose derivatives differences of its neighbours are."""
        laws, count = self._model.space.forces.laws, len(self._work.branches)
        if count:
            self.slopes()
        self._held = np.array([branch_of(laws, self._work.registers, k) for k in range(count)])
        try:
            yield
        finally:
            self._held = UNKNOWN

    def _begin(self, held):
        """Let a neighbour slide along the surfaces of the state, with shares of its own; held : the other branches."""
        surfaces, kept = self._model.space.forces.laws.surfaces, self._work.angle[self._kept]
        self._work.branches[:] = held
        self._work.branches[surfaces] = np.where(kept > 1.0, kept, self._work.branches[surfaces])

    @property
    def has_loads(self):
        """Whether friction depends on the load."""
        return self._model.has_loads

    @property
    def modes(self):
        """(k, 5) modes of the joints with stops or friction, as Sample.switching."""
        return modes_of(self._model, self._work)

    @modes.setter
    def modes(self, modes):
        set_modes(self._model, self._work, modes)
        self._work.known[0] = 0.0

    def release(self, stops=False):
        """Let joints that rest by dry friction move without it, and with `stops` those at their stops."""
        modes = self.modes
        own = np.array([stops and switch.kind in (TURN, SLIDE) for switch in self.layout.switches], dtype=bool)
        modes[own | (modes[:, 2] == 0.0), :3] = 0.0
        self.modes = modes

    def oppose(self, modes):
        """Set dry friction against the rates of the state; joints at rest have given modes (k, 5)."""
        rates = self.switch_rates()
        moves = np.abs(rates) > MOVES
        modes = modes.copy()
        modes[moves, 0], modes[moves, 1] = 0.0, np.sign(rates[moves])
        self.modes = modes

    def switch_rates(self, y=None):
        """(k,) rates of the coordinates with stops or friction at a neighbour y (f, 2), rad/s or m/s."""
        self.slopes(y)
        out = np.empty((len(self.layout.switches), 2))
        set_rates(self._model, self._work, out)
        return self._model.switches["sign"] * out[:, 0]

    def largest_friction(self, acting=None):
        """(k,) largest friction at rest of the coordinates with stops or friction, N m or N, with an Acting."""
        table, most = self._model.switches, self._model.switches["static"].copy()
        if self._model.has_loads:
            self.slopes(None, acting)
            most += table["static_by_load"] * self._work.loads[:, FOUND]
        return most

    @property
    def angles(self):
        """(k,) unwrapped angles of the state, as Sample.angles."""
        return self._work.angle

    @property
    def is_closed(self):
        """Whether neighbours must satisfy cut joints, couplings, driven joints, or held rows."""
        return len(self._model.cuts) > 0

    def go_to(self, y):
        """Move the state to a neighbour y (f, 2), projected onto the cut joints. Raises SimulationError."""
        rates, self.pose, self.twist = self.closed(y)
        self._work.angle[:] = self.with_states(self.layout.angles(self.pose, self._work.angle), rates)
        self._work.known[0] = 0.0

    def _set_states(self, angles, states):
        """Set the states of laws, which follow the unwrapped angles."""
        angles[len(angles) - len(states) :] = states

    def with_states(self, angles, rates):
        """Unwrapped angles (k,) followed by the states of laws among the rates (f,) of a neighbour."""
        found = angles.copy()
        self._set_states(found, rates[self.state_freedoms])
        return found

    def beside(self, y):
        """Rates, poses and twists as from `closed`, where stops and friction hold nothing."""
        modes = self.modes
        free = modes.copy()
        free[:, :3] = 0.0
        try:
            self.modes = free
            return self.closed(y)
        finally:
            self.modes = modes

    def keep(self):
        """The state, for `restore`."""
        return self.pose, self.twist, self._work.angle.copy()

    def restore(self, kept):
        """Return to a state that `keep` gave."""
        self.pose, self.twist, self._work.angle[:] = kept
        self._work.known[0] = 0.0

    def slopes(self, y=None, acting=None):
        """(2 f,) psi' and w' at a neighbour y (f, 2), and poses and twists of the bodies, at the centres of mass.

        acting : Acting; None: that of the state. Raises SimulationError
        """
        out, pose, twist = np.empty((self.freedoms, 2)), self.pose.copy(), self.twist.copy()
        self._call(_evaluate, y, acting, out, pose, twist)
        self._states = self._work.stage_twist[len(self.pose) + self._model.law_links, 0]
        self._shares = self._work.branches[self._model.space.forces.laws.surfaces]
        return out.T.ravel(), pose, twist

    def tangents(self, directions, sizes, external=None, targets=None):
        """Derivatives along directions (d, f, 2) of y: of psi' and w' (d, 2 f), their errors (d,), of J V (d, m).

        sizes : (d,) first distances of differences
        external, targets : (d, n, COLUMNS), (d, k, 2) changes of the inputs; None: none
        See tangents.py. The error is relative, NOT_SMOOTH where differences of a row have no digits, near singular
        poses, with friction by load, and along surfaces of laws. Raises SimulationError.
        """
        model, work, count = self._model, self._work, len(directions)
        n, L, m, f = len(model.bodies), len(model.links), len(model.row_residual), self.freedoms
        out, state = np.zeros((count, 2 * f + 1 + m)), (self.pose, self.twist, self.acting.external)
        external = np.zeros((count, *self.acting.external.shape)) if external is None else external
        targets = np.zeros((count, *self.acting.targets.shape)) if targets is None else targets
        moves = np.ascontiguousarray(np.swapaxes(directions, 1, 2), dtype=float).reshape(2 * count * f, 1)
        work.targets[:] = self.acting.targets
        self._begin(UNKNOWN)
        status = tangents(
            model,
            work,
            moves,
            external.reshape(count * n, external.shape[2]),
            targets.reshape(-1, 2),
            np.ascontiguousarray(sizes, dtype=float),
            state,
            np.zeros((9 * L, 6)),
            np.zeros((2, n, 6)),
            np.zeros((4, m)),
            np.zeros((3, 7)),
            np.zeros((f, 1)),
            out,
        )
        if status not in (OK, NOT_REGULAR) or not np.isfinite(out).all():
            status = NOT_FINITE if status in (OK, NOT_REGULAR) else status
            raise SimulationError(explain(self._engine, status), status & 0xFF)
        if status == NOT_REGULAR or model.has_loads or len(self.slides):
            out[:, 2 * f] = NOT_SMOOTH
        return out[:, : 2 * f], out[:, 2 * f], out[:, 2 * f + 1 :]

    def derivatives(self, directions, sizes, external=None, targets=None):
        """(d, 2 f) derivatives of psi' and w' along directions of y and the inputs, and their errors (d, 2 f).

        Arguments as of `tangents`; differences of the accelerations where those have no digits. Raises SimulationError.
        """
        found, uncertain, _ = self.tangents(directions, sizes, external, targets)
        errors = (uncertain + ROUND_OFF)[:, None] * np.abs(found).max(axis=1, initial=0.0)[:, None] + 0.0 * found

        def slopes(d, s):
            given = self.acting
            if external is not None:
                given = given._replace(
                    external=given.external + s * external[d], targets=given.targets + s * targets[d]
                )
            return self.slopes(s * directions[d], given)[0]

        if (rough := np.flatnonzero(uncertain == NOT_SMOOTH)).size:
            with self.holding():
                parts = [derivative(lambda s, d=d: slopes(d, s), sizes[d]) for d in rough]
            found[rough], errors[rough] = (np.array(part) for part in zip(*parts))
        return found, errors

    def closed(self, y=None):
        """(f,) rates of a neighbour that is projected onto the cut joints, and poses and twists of the bodies."""
        rates, pose, twist = np.empty(self.freedoms), self.pose.copy(), self.twist.copy()
        self._call(_close, y, None, rates, pose, twist)
        return rates, pose, twist

    def gaps(self, y=None):
        """(m,) position residuals of all rows of cut joints at a neighbour, rad and m."""
        gaps = np.empty(len(self._model.row_residual))
        self._call(_gaps, y, None, gaps)
        return gaps

    def equations(self, other):
        """(f + 2 m,) w', position residuals and J V at the coordinates of another Probe, which was evaluated."""
        self._meet(other)
        out = np.empty(self.freedoms + 2 * len(self._model.row_residual))
        given = other._work.pose, other._work.twist, self.acting.external, self.pose, self.twist, out
        self._begin(other._held)
        self._done(self._equations(self._model, self._work, *given), out)
        return out

    @property
    def is_switched(self):
        """(m,) whether a row is that of a stop or of friction."""
        return self._model.switched != 0

    def _call(self, kernel, y, acting, *out):
        work, acting = self._work, self.acting if acting is None else acting
        work.targets[:] = acting.targets
        y = self._zeros if y is None else np.ascontiguousarray(y, dtype=float)
        self._begin(self._held)
        self._done(kernel(self._model, work, self._scheme, y, self.pose, self.twist, acting.external, *out), *out)

    def _done(self, status, *out):
        if status != OK or not all(math.isfinite(array.sum()) for array in out):
            raise SimulationError(explain(self._engine, status), status & 0xFF)
        if OPEN in self._work.branches:
            raise SimulationError("the shares of both sides of a comparison of a law are not determined")

    def neighbour(self, y=None):
        """Sample of a neighbour y (f, 2); None: of the state."""
        return self.sample(*self.slopes(y)[1:])

    def sample(self, pose, twist, acting=None):
        """Sample of a neighbour with its Acting; poses and twists are those of the last `slopes`."""
        base, angles = self.base, self._work.angle.copy()
        self._set_states(angles, self._states)
        angles[self._kept] = self._shares
        found = Sample(self.layout, base.time, base.time_ns, base.steps, pose, twist, angles)
        found.acting, found.joint_efforts = base.acting if acting is None else acting, base.joint_efforts
        if base.switching is not None:
            found.switching = self.modes
        return found
