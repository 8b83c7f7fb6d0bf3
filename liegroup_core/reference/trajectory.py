# SPDX-License-Identifier: Apache-2.0
"""Reference integration of a scene under piecewise constant wrenches, with its uncertainty."""

from typing import NamedTuple

import numpy as np
from scipy.linalg import qr
from scipy.spatial.transform import Rotation

from liegroup_core.errors import SimulationError
from liegroup_core.joints.motion import at, row_at
from liegroup_core.scene.assembly import assembled
from liegroup_core.scene.centres import Offsets, at_centres_of_mass
from liegroup_core.scene.consistency import resolve_drives
from liegroup_core.threads import one_blas_thread

from .collocation import CollocationSteps
from .laws import HeldValues
from .loads import LOADS
from .rigid_body_dae import STATE, chosen_rows, rates, unit_rows
from .system import build_system, with_targets

# Tolerance of the error inside a step, relative to the characteristic length and in rad. The uncertainty of a run is
# its distance to a run with a tolerance LOOSER times larger, whose steps are about a third longer, and round-off.
TIGHT = 1e-13
LOOSER = 50.0
# Part of each number that both lose, because their steps end where laws change. It is added to the uncertainty.
ROUND_OFF = 64.0 * np.finfo(float).eps
# The integration ends where its uncertainty exceeds this, relative to the characteristic length or in rad: a
# hundredth of the default accuracy of a run.
UNCERTAIN = 1e-6
MOST_STEPS = 2_000_000
# Every LOOKS steps the integration ends if the first requested time after the start would take more than HOPELESS
# steps: the motion is unrealistically fast.
LOOKS, HOPELESS = 500, 1_000_000
SLOWEST = 0.1  # 1/s, rate of a motion that is as good as at rest
# Steps and times between two comparisons of the two runs, after which the motion may be found to be unknown, and steps
# between two reports of progress.
FEW_STEPS, MOST_TIMES, TOLD = 100, 64, 10
# Bounds of the singular values of the unit rows of all joints. At the start, values below REDUNDANT
# belong to redundant rows (the pose is accurate to 1e-9 or better). Ten rods on revolute joints have
# 1e-2. At a singular pose the value of an independent row falls below SINGULAR, or redundant rows have a gap
# above it.
REDUNDANT, SINGULAR = 1e-8, 1e-6
FLAT = 0.1  # part of the ratio of pivots at the last choice of rows, below which they are chosen again


class WrenchSpan(NamedTuple):
    """Wrench on a body from one time to another; several of them add."""

    start: float  # s
    end: float  # s, or infinity
    body: str
    wrench: tuple  # (6,) torque N m, force N
    axes: str = "body"  # or "world"
    point: tuple | None = None  # (3,) m, in the body frame, at which the force acts; None: its origin


class PullSpan(NamedTuple):
    """Spring and damper from a point of a body to one in the world, from one time to another; one of a body at most."""

    start: float  # s
    end: float  # s, or infinity
    body: str
    to: tuple  # (3,) m, world axes
    stiffness: float  # N/m
    damping: float  # N s/m
    point: tuple | None = None  # (3,) m, in the body frame; None: its origin
    torque: tuple = (0.0, 0.0, 0.0)  # N m, world axes
    turning_damping: float = 0.0  # N m s/rad


class JointChange(NamedTuple):
    """Targets of the servo of a joint, or motion of a driven joint, from `time` on."""

    time: float  # s
    joint: str
    values: tuple  # (2,) position and velocity, rad and rad/s, or m and m/s; or (7,), see joints/motion.py


class Trajectory(NamedTuple):
    """Motion of the frames of n bodies at k times."""

    times: np.ndarray  # (k,) s
    rotation: np.ndarray  # (k, n, 3, 3) body -> world
    position: np.ndarray  # (k, n, 3) m, world
    twist: np.ndarray  # (k, n, 6) rad/s, m/s; body axes


class Distance(NamedTuple):
    """Distances of two trajectories per time and body, each (k, n)."""

    position: np.ndarray  # m
    attitude: np.ndarray  # |R_1 - R_2|_2 = 2 sin(angle / 2), at most 2
    angle: np.ndarray  # rad, of the rotation between them
    angular: np.ndarray  # rad/s
    linear: np.ndarray  # m/s


def distance(one, other):
    """Distance of two trajectories with the same times and bodies.

    For rotations |R_1 - R_2|_2 is the Frobenius norm divided by sqrt(2): no singular value
    decomposition is needed.
    """
    chord = np.linalg.norm(one.rotation - other.rotation, axis=(2, 3)) / np.sqrt(2.0)
    twist = one.twist - other.twist
    return Distance(
        np.linalg.norm(one.position - other.position, axis=2),
        chord,
        2.0 * np.arcsin(np.minimum(chord / 2.0, 1.0)),
        np.linalg.norm(twist[..., :3], axis=2),
        np.linalg.norm(twist[..., 3:], axis=2),
    )


def integrate(scene, pose, twist, times, changes=(), start=0.0, rtol=TIGHT):
    """Integrate from a state at `start`. Steps end exactly where a wrench changes.

    scene   : Scene
    pose    : (n, 12) R row by row (body -> world), then r in m, at `start`
    twist   : (n, 6) body-fixed, at `start`. Pose and twist are those of the frames at the centres of
              mass, as from Simulation.state
    times   : (k,) s, increasing, not before `start`
    changes : WrenchSpan, PullSpan and JointChange, the latter in the order of their times. Before the first of these,
              targets and motions are those of the scene
    rtol    : tolerance of the error inside a step, relative to the characteristic length and in rad
    returns (Trajectory at `times`, its uncertainty as a Distance: the largest distance so far to
    a run with a tolerance LOOSER times larger)

    Angles of torsional springs are in (-pi, pi] at `start` and unwrapped from there.
    Raises SimulationError if the integration cannot continue, for instance at a singular pose.
    Accuracy: test_reference.py, against 45-digit end states; test_reference_kinds.py, every kind
    of joint and force against the engine.
    """
    times = np.asarray(times, dtype=float)
    if len(times) and (times[0] < start or np.any(np.diff(times) < 0.0)):
        raise ValueError("times must increase and must not be before start")
    end = times[-1] if len(times) else start
    return Reference(scene, pose, twist, changes, start, end, rtol).at(times)


class Reference:
    """Integration as by `integrate`, continued from one call of `at` to the next.

    end    : s, last time that can be requested
    angles : (u,) rad, those of `Scene.unwrapped` at `start`, then numbers of laws; None: in (-pi, pi], and their starts
    most_steps : limit of the steps of each of the two integrations
    The other arguments are those of `integrate`.

    stopped : one line that says why no later time can be reached, or None
    """

    @one_blas_thread()
    def __init__(
        self, scene, pose, twist, changes=(), start=0.0, end=np.inf, rtol=TIGHT, angles=None, most_steps=MOST_STEPS
    ):
        scene = assembled(scene)
        pose, self._offsets = np.asarray(pose, dtype=float), Offsets(scene)
        is_new = angles is None
        system, angles, sampled = build_system(at_centres_of_mass(scene), pose, angles)
        state = np.concatenate([_to_state(pose, np.asarray(twist, dtype=float)), angles])
        pieces = _pieces(scene, system, self._offsets, changes, start, end)
        self._shape, self._length = (len(pose), STATE), system.size
        self._runs = [
            _Run(system, state, start, pieces, part * rtol, most_steps, sampled, len(pose), part == 1)
            for part in (1, LOOSER)
        ]
        for run in self._runs if is_new else ():
            run.sampling.meet(start, state)
        self._largest, self.stopped = None, None

    @property
    def steps(self):
        """Number of steps so far of the integration with the smaller tolerance."""
        return self._runs[0].steps_taken

    def at(self, times):
        """Trajectory at times (k,), increasing and after earlier calls, with its uncertainty so far.

        Raises SimulationError if not all times can be reached.
        """
        found = self.up_to_limit(times)
        if len(found[0].times) < len(times):
            raise SimulationError(self.stopped)
        return found

    @one_blas_thread()
    def up_to_limit(self, times, tell=lambda time: None):
        """As `at`, for the times that can be reached; calls `tell` with a time that has been reached, now and then."""
        times, parts = np.asarray(times, dtype=float), []
        done, count = 0, 1
        while done < len(times) or not parts:
            before = self.steps
            parts.append(self._compared(times[done : done + count], tell))
            done += count
            count = min(2 * count, MOST_TIMES) if self.steps - before < FEW_STEPS else max(count // 2, 1)
        trajectories, uncertainties = zip(*parts)
        return (
            Trajectory(*map(np.concatenate, zip(*trajectories))),
            Distance(*map(np.concatenate, zip(*uncertainties))),
        )

    def _compared(self, times, tell):
        """As `up_to_limit`, for few times."""
        times, states = times if self.stopped is None else times[:0], []
        for run in self._runs:
            states.append(run.at(times, tell))
            tell = None
            times = times[: len(states[-1])]
            self.stopped = self.stopped or run.stopped
        tight, loose = (
            _at_bodies(self._offsets, _to_trajectory(times, part[: len(times)], self._shape)) for part in states
        )
        apart = map(np.add, distance(tight, loose), _round_off(tight, self._length))
        largest = Distance(*(np.maximum.accumulate(part, axis=0) for part in apart))
        if self._largest is not None:
            largest = Distance(*map(np.maximum, largest, self._largest))
        unknown = np.maximum(largest.position / self._length, largest.angle).max(axis=1, initial=0.0) > UNCERTAIN
        if unknown.any():
            k = int(np.argmax(unknown))
            self.stopped = (
                f"from t = {times[k]:.6g} s on the uncertainty of the reference integration exceeds {UNCERTAIN:g} "
                "(of the characteristic length, or rad), because the motion amplifies small differences"
            )
            tight, largest = Trajectory(*(part[:k] for part in tight)), Distance(*(part[:k] for part in largest))
        if len(tight.times):
            self._largest = Distance(*(part[-1] for part in largest))
        return tight, largest


def _round_off(motion, length):
    """Distance (k, n) of two trajectories that are equal up to round-off;  length : characteristic length, m."""
    speed, spin = (np.linalg.norm(part, axis=2) for part in (motion.twist[..., 3:], motion.twist[..., :3]))
    turn, position = np.ones_like(spin), length + np.linalg.norm(motion.position, axis=2)
    return Distance(*(ROUND_OFF * part for part in (position, turn, turn, spin, speed)))


def _pieces(scene, system, offsets, changes, start, end):
    """Intervals of constant wrenches, constant targets of servos, and one motion of each drive.

    returns [(start, end, System, wrenches (n, LOADS) of loads.add_loads, [(7,) of each driven joint])]
    """
    targets, commanded, motions = {}, {}, resolve_drives(scene)
    index = {body.name: i for i, body in enumerate(scene.bodies)}
    spans = [change for change in changes if not isinstance(change, JointChange)]
    spans += [_span(force) for force in scene.forces if force.type == "applied_wrench"]
    # Sorted by time; changes at the same time keep their order.
    switches = sorted(
        [(change.time, change) for change in changes if isinstance(change, JointChange)]
        + [(time, span) for span in spans for time in (span.start, span.end)]
        + [(time, None) for rows in motions.values() for time in rows[1:, 0]],
        key=lambda switch: switch[0],
    )
    wrench = np.zeros((len(scene.bodies), LOADS))
    wrench[:, 12:15] = -offsets.com
    on_body = [[] for _ in scene.bodies]  # spans that have begun and not ended
    pieces = []
    since = start
    for time, change in [*switches, (end, None)]:
        if min(time, end) > since:
            until = min(time, end)
            # The middle is away from all starts and ends, so that round-off does not matter.
            middle = 0.5 * (since + until)
            driving = [commanded.get(scene.joints[j].name, row_at(rows, middle)) for j, rows in motions.items()]
            piece = since, until, system, wrench.copy(), driving
            if pieces and _is_same(pieces[-1], piece):
                pieces[-1] = pieces[-1][0], *piece[1:]
            else:
                pieces.append(piece)
            since = until
        if isinstance(change, JointChange) and len(change.values) == 2:
            targets[change.joint] = change.values
            system = with_targets(system, scene, targets)
        elif isinstance(change, JointChange):
            commanded[change.joint] = np.array(change.values)
        elif change is not None:
            body = index[change.body]
            # A span is found twice: where it starts, and where it ends.
            if any(change is other for other in on_body[body]):
                on_body[body] = [other for other in on_body[body] if other is not change]
            else:
                on_body[body].append(change)
            _set_row(wrench[body], body, on_body[body], offsets)
    return pieces


def _is_same(piece, following):
    """Whether nothing changes between two pieces."""
    _, _, system, *arrays = piece
    return system is following[2] and all(map(np.array_equal, arrays, following[3:]))


def _span(push):
    """WrenchSpan of an applied wrench of a scene."""
    end = np.inf if push.end is None else push.end
    return WrenchSpan(push.start, end, push.body, (*push.torque, *push.force), push.axes, push.point)


def _set_row(row, body, spans, offsets):
    """Set the loads (LOADS,) of loads.add_loads on a body to the sum of the wrenches of spans, and to a pull."""
    row[:12], row[15:] = 0.0, 0.0
    for span in spans:
        if isinstance(span, PullSpan):
            place = (0.0, 0.0, 0.0) if span.point is None else span.point
            row[24:] = *span.to, *(place - offsets.com[body]), *span.torque, *span[4:6], span.turning_damping
            continue
        wrench = np.array(span.wrench, dtype=float)
        if span.axes == "body":
            if span.point is not None:
                wrench[:3] += np.cross(span.point, wrench[3:])
            row[:6] += offsets.wrench_at_centre(body, wrench)
        else:
            row[6:12] += wrench
            if span.point is not None:
                row[15:24] += np.outer(span.point, wrench[3:]).ravel()


def _independent(system, rows):
    """Numbers of independent unit rows at the start: as many as there are singular values above the largest jump.

    Singular values of redundant rows are of the size of round-off or of the initial residual, up to
    1e-9 (scene/consistency.py). Those of independent unit rows are of the size of the angles between
    them.
    """
    joints, rank = np.flatnonzero(rows.any(axis=1)), 0
    if len(joints):
        singular = np.linalg.svd(rows[joints], compute_uv=False)
        rank = len(singular)
        if len(joints) > rank or singular[-1] <= REDUNDANT:
            above = np.append(np.maximum(singular, np.finfo(float).eps), np.finfo(float).eps)
            ends = np.flatnonzero(above[1:] <= REDUNDANT) + 1
            rank = int(ends[np.argmax(above[ends - 1] / above[ends])])
    return _best_rows(system, rows, rank), rank


def _best_rows(system, rows, rank):
    """Chosen rows: those that are farthest from each other, and all rows of rotors."""
    joints = np.flatnonzero(rows.any(axis=1))
    if len(joints) > rank:
        joints = joints[qr(rows[joints].T, mode="r", pivoting=True)[1][:rank]]
    return chosen_rows(system, sorted([*joints, *np.flatnonzero(system.equations.compliance)]))


class _Run:
    """Integration with one tolerance, continued from one call of `at` to the next."""

    def __init__(self, system, state, start, pieces, rtol, most_steps, sampled, bodies, halves):
        self.sampling = HeldValues(system.laws, sampled, bodies)
        # Of two runs whose steps end at the same instants, the more exact one takes two: else both had the same errors.
        self._halves = halves
        self._system, self._rtol, self._most_steps = system, rtol, most_steps
        self._pending = list(pieces)
        self._state, self.reached = state, start
        self._solver = self.stopped = None
        self.steps_taken = 0
        self._start = self._seen = start
        self._is_useful = False  # a later time than the start has been reached

    def at(self, times, tell=None):
        """States (k, 13 n + t) at increasing times (k,), or at those that can be reached; see up_to_limit."""
        out = np.empty((len(times), len(self._state)))
        done = 0
        while True:
            ready = done + int(np.searchsorted(times[done:], self.reached, side="right"))
            if ready > done:
                out[done:ready] = self._state if self._solver is None else self._solver.at(times[done:ready])
                done = ready
                self._is_useful |= bool(times[done - 1] > self._start)
            if done == len(times) or self.stopped:
                return out[:done]
            if tell is not None and self.steps_taken % TOLD == 0:
                tell(self.reached)
            if self.steps_taken == self._most_steps:
                self.stopped = f"the reference integration reached its limit of steps, {self._most_steps}"
            elif not self._is_useful and self.steps_taken and self.steps_taken % LOOKS == 0:
                self._look_ahead(times[done])
            if not self.stopped and not self._advance():  # the last time is the end, up to round-off
                out[done:] = self._state
                return out

    def _look_ahead(self, time):
        """Stop if a time would take far too many steps; called every LOOKS steps."""
        advanced, self._seen = self.reached - self._seen, self.reached
        if (time - self.reached) * LOOKS > HOPELESS * advanced:
            self.stopped = (
                f"the reference integration would need more than {HOPELESS} steps from t = "
                f"{self.reached:.6g} s to {time:.6g} s: the motion is too fast for it"
            )

    def _advance(self):
        """Take one step; returns False at the end of the last interval."""
        if self._solver is None or self.reached >= self._end:
            if not self._pending:
                return False
            begin, end, *given = self._pending.pop(0)
            if self._solver is not None:
                self.sampling.meet(begin, self._state, self._solver.surfaces.sides)
            change = self.sampling.before(begin, end)
            if change < end:
                self._pending.insert(0, (change, end, *given))
                if self._halves:
                    self._pending.insert(0, (0.5 * (begin + change), change, *given))
                    change = self._pending[0][0]
            self._begin(begin, change, *given)
        solver = self._solver
        self.steps_taken += 1
        moves = solver.advance(self._end)
        if solver.surfaces.after(solver, moves):
            solver.restart()
            moves = True
        self._state, self.reached = solver.state, solver.time
        rows, gap = unit_rows(self._system, self._state, self._given(self.reached))
        gap = np.abs(gap).max(initial=0.0)
        if not moves or gap > SINGULAR or self._pivot < SINGULAR:
            self.stopped = self._cause(rows, gap, moves)
        if self._pivot_of_choice is None:
            self._pivot_of_choice = self._pivot
        elif self._pivot < FLAT * self._pivot_of_choice:
            self._chosen, self._pivot_of_choice = _best_rows(self._system, rows, self._rank), None
        return True

    def _cause(self, rows, gap, moves):
        """Why the integration ends at the present state; None: it goes on."""
        singular = np.linalg.svd(rows, compute_uv=False) if self._rank else np.ones(1)
        if gap > SINGULAR or singular[max(self._rank - 1, 0)] < SINGULAR:
            return (
                f"the reference integration reached a singular configuration at t = {self.reached:.6g} s, "
                "where the constraints do not determine the motion"
            )
        if moves:
            return None
        slope = np.empty((1, len(self._state)))
        self._function(np.array([self.reached]), self._state[None], slope)
        if not np.isfinite(slope).all():
            return f"the reference integration stopped at t = {self.reached:.6g} s: the state or a wrench is not finite"
        return (
            f"the reference integration stopped at t = {self.reached:.6g} s: no step is short enough, as where forces "
            "jump or grow without bound, or change their branches too often"
        )

    def _begin(self, begin, end, system, wrench, driving):
        self._driving, self._end = driving, end
        system = system._replace(laws=self.sampling.loads)

        def function(times, states, out, sides=None):
            given = np.stack([self._given(time) for time in times])
            sides = np.tile(self._solver.surfaces.sides, (len(times), 1)) if sides is None else sides
            heights = np.zeros_like(sides)
            self._pivot = rates(system, self._chosen, times, given, states, wrench, out, sides, heights)
            return heights

        if self._solver is None:
            self._chosen, self._rank = _independent(system, unit_rows(system, self._state, self._given(begin))[0])
            self._pivot_of_choice = None
            self._solver = CollocationSteps(
                function, self._scales, begin, self._state, self._rtol, int(system.laws.sizes[2]), self._halves
            )
            self._solver.surfaces.start(self._solver)
        self._function = self._solver.function = function
        self._solver.restart()

    def _given(self, time):
        given = np.zeros((3, len(self._driving)))
        for d, motion in enumerate(self._driving):
            given[:, d] = at(motion, time)
        return given

    def _scales(self, state, slope):
        """Sizes that errors are relative to: the mechanism, a radian, and their change at the rate of the motion."""
        n = len(self._system.mass)
        out, bodies = np.ones(len(state)), state[: STATE * n].reshape(n, STATE)
        scale, size = out[: STATE * n].reshape(n, STATE), self._system.size
        change = np.abs(slope[: STATE * n].reshape(n, STATE))
        rate = max(change[:, 4:7].max() / size, np.abs(bodies[:, 10:13]).max(), SLOWEST)
        rate = max(rate, np.sqrt(max(change[:, 7:10].max() / size, change[:, 10:13].max())))
        scale[:, 4:7] = size + np.abs(bodies[:, 4:7])
        scale[:, 7:10], scale[:, 10:13] = size * rate, rate
        out[len(out) - len(self._system.laws.scales) :] = self._system.laws.scales
        out[STATE * n :] += np.abs(state[STATE * n :])
        return out


def _to_state(pose, twist):
    state = np.empty((len(pose), STATE))
    turn = Rotation.from_matrix(pose[:, :9].reshape(-1, 3, 3))
    x, y, z, w = turn.as_quat().T
    state[:, :4] = np.stack((w, x, y, z), axis=1)
    state[:, 4:7] = pose[:, 9:]
    state[:, 7:10] = turn.apply(twist[:, 3:])
    state[:, 10:13] = twist[:, :3]
    return state.ravel()


def _at_bodies(offsets, motion):
    """Convert a motion of the frames at the centres of mass to the body frames."""
    k, n = motion.position.shape[:2]
    pose = np.concatenate([motion.rotation.reshape(k, n, 9), motion.position], axis=2)
    pose, twist = offsets.to_bodies(pose, motion.twist)
    return motion._replace(position=pose[..., 9:], twist=twist)


def _to_trajectory(times, states, shape):
    k, n = len(times), shape[0]
    states = states[:, : n * STATE].reshape(k, *shape)
    turn = Rotation.from_quat(states[..., [1, 2, 3, 0]].reshape(-1, 4)).as_matrix().reshape(k, n, 3, 3)
    # R^T v, in sums whose bits do not depend on the number of times.
    velocity = sum(turn[..., j, :] * states[..., 7 + j, None] for j in range(3))
    return Trajectory(times, turn, states[..., 4:7], np.concatenate((states[..., 10:13], velocity), axis=2))
