# SPDX-License-Identifier: Apache-2.0
"""Tight integration of a scene under piecewise constant wrenches, with its own uncertainty."""
from typing import NamedTuple

import numpy as np
from scipy.integrate import DOP853
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from ..errors import SimulationError
from ..scene.consistency import resolve_frames
from .rigid_body_dae import GROUND, JOINT_ROWS, STATE, System, rate

# Just above the least that DOP853 accepts (2.2e-14). The uncertainty of a run is its distance to
# one that is ten times looser.
TIGHT = 1e-13
LOOSER = 10.0


class WrenchChange(NamedTuple):
    """From `time` on this is the total wrench on the body."""

    time: float             # s
    body: str
    wrench: tuple           # (6,) torque N m, force N; body axes, about the centre of mass


class Trajectory(NamedTuple):
    """Motion of n bodies at k times."""

    times: np.ndarray       # (k,) s
    rotation: np.ndarray    # (k, n, 3, 3) body -> world
    position: np.ndarray    # (k, n, 3) m, world
    twist: np.ndarray       # (k, n, 6) rad/s, m/s; body axes


class Distance(NamedTuple):
    """How far two trajectories are apart, per time and body: each (k, n)."""

    position: np.ndarray    # m
    attitude: np.ndarray    # |R_1 - R_2|_2 = 2 sin(angle / 2), at most 2
    angle: np.ndarray       # rad, of the rotation between them
    angular: np.ndarray     # rad/s
    linear: np.ndarray      # m/s


def distance(one, other):
    """Distance of two trajectories of the same times and bodies.

    For rotations |R_1 - R_2|_2 is the Frobenius norm over sqrt(2), without a singular value
    decomposition per sample.
    """
    chord = np.linalg.norm(one.rotation - other.rotation, axis=(2, 3)) / np.sqrt(2.0)
    twist = one.twist - other.twist
    return Distance(np.linalg.norm(one.position - other.position, axis=2), chord,
                    2.0 * np.arcsin(np.minimum(chord / 2.0, 1.0)),
                    np.linalg.norm(twist[..., :3], axis=2), np.linalg.norm(twist[..., 3:], axis=2))


def integrate(scene, pose, twist, times, changes=(), start=0.0, rtol=TIGHT):
    """Motion from a state at `start`, with steps that end exactly where a wrench changes.

    scene   : Scene
    pose    : (n, 12) R row by row (body -> world), then r in m, at `start`
    twist   : (n, 6) body-fixed, at `start`
    times   : (k,) s, increasing, not before `start`
    changes : WrenchChange in the order of their times; before the first one nothing acts
    returns (Trajectory at `times`, its uncertainty as a Distance: the largest distance so far to
    a run at a tolerance ten times looser)

    Raises SimulationError where the integration cannot go on.
    Accuracy: test_reference.py, against 45-digit end states.
    """
    times = np.asarray(times, dtype=float)
    if len(times) and (times[0] < start or np.any(np.diff(times) < 0.0)):
        raise ValueError("times must increase and not lie before start")
    system = build_system(scene)
    state = _to_state(np.asarray(pose, dtype=float), np.asarray(twist, dtype=float))
    pieces = _pieces(scene, times, changes, start)
    tight = _to_trajectory(times, _run(system, state, times, pieces, rtol))
    loose = _to_trajectory(times, _run(system, state, times, pieces, LOOSER * rtol))
    apart = distance(tight, loose)
    return tight, Distance(*(np.maximum.accumulate(part, axis=0) for part in apart))


def build_system(scene):
    """Arrays of a scene. Raises SimulationError for a joint or force without equations here."""
    index = {body.name: i for i, body in enumerate(scene.bodies)} | {"world": GROUND}
    for entry, known in [(j, JOINT_ROWS) for j in scene.joints] + [
            (f, ("spring_damper",)) for f in scene.forces]:
        if entry.type not in known:
            raise SimulationError(f"the reference integration has no {entry.type} ({entry.name})")
    inertia = np.array([body.inertia_matrix for body in scene.bodies])
    inverse = np.linalg.inv(inertia)
    joints, springs, frames = scene.joints, scene.forces, resolve_frames(scene)
    return System(
        gravity=np.array(scene.gravity, dtype=float),
        mass=np.array([body.mass for body in scene.bodies], dtype=float),
        inertia=inertia, inertia_inverse=inverse, weight=_weight(scene.bodies, inverse),
        joint_body=_table([(index[j.parent], index[j.child]) for j in joints], (2,), int),
        joint_point=_table([(a[:3, 3], b[:3, 3]) for a, b in frames], (2, 3)),
        joint_axes=_table([(a[:3, 0], a[:3, 1], b[:3, 2]) for a, b in frames], (3, 3)),
        joint_rows=_table([JOINT_ROWS[j.type] for j in joints], (), int),
        spring_body=_table([(index[s.parent], index[s.child]) for s in springs], (2,), int),
        spring_point=_table([(s.parent_point, s.child_point) for s in springs], (2, 3)),
        spring_law=_table([(s.stiffness, s.damping, s.rest_length) for s in springs], (3,)))


def _weight(bodies, inertia_inverse):
    """W with W W^T = M^-1, block by block."""
    blocks = [block for body, inverse in zip(bodies, inertia_inverse)
              for block in (np.eye(3) / np.sqrt(body.mass), np.linalg.cholesky(inverse))]
    return block_diag(*blocks)


def _table(rows, shape, kind=float):
    return np.array(rows, dtype=kind).reshape((len(rows), *shape))


def _pieces(scene, times, changes, start):
    """(from, to, wrenches (n, 6)) of each interval with constant wrenches."""
    index = {body.name: i for i, body in enumerate(scene.bodies)}
    end = times[-1] if len(times) else start
    wrench = np.zeros((len(scene.bodies), 6))
    pieces = []
    since = start
    for change in changes:
        if change.time >= end:
            break
        if change.time > since:
            pieces.append((since, change.time, wrench.copy()))
            since = change.time
        wrench[index[change.body]] = change.wrench
    if end > since:
        pieces.append((since, end, wrench))
    return pieces


def _run(system, state, times, pieces, rtol):
    """States (k, 13 n) at `times`."""
    out = np.empty((len(times), len(state)))
    done = int(np.searchsorted(times, pieces[0][0], side="right")) if pieces else len(times)
    out[:done] = state
    step = None
    for begin, end, wrench in pieces:
        def function(t, y, wrench=wrench):
            slope = np.empty_like(y)
            rate(system, y, wrench, slope)
            if not np.isfinite(slope).all():        # DOP853 would look for a step for ever
                raise SimulationError(f"the reference integration stopped at {t:.6g} s: "
                                      "the state or a wrench is not finite")
            return slope

        # A piece goes on with the step of the one before, which a short piece must not shrink.
        solver = DOP853(function, begin, state, end, rtol=rtol, atol=rtol,
                        first_step=None if step is None else min(step, end - begin))
        steps = []
        while solver.status == "running":
            message = solver.step()
            if solver.status == "failed":
                raise SimulationError(f"the reference integration stopped at {solver.t:.6g} s: "
                                      f"{message}")
            steps.append(solver.step_size)
            upto = int(np.searchsorted(times, solver.t, side="right"))
            if upto > done:
                out[done:upto] = solver.dense_output()(times[done:upto]).T
                done = upto
        step = max(steps) if step is None or len(steps) > 1 else max(step, *steps)
        state = solver.y
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


def _to_trajectory(times, states):
    states = states.reshape(len(times), -1, STATE)
    k, n = states.shape[:2]
    turn = Rotation.from_quat(states[..., [1, 2, 3, 0]].reshape(-1, 4))
    velocity = turn.apply(states[..., 7:10].reshape(-1, 3), inverse=True).reshape(k, n, 3)
    return Trajectory(times, turn.as_matrix().reshape(k, n, 3, 3), states[..., 4:7],
                      np.concatenate((states[..., 10:13], velocity), axis=2))
