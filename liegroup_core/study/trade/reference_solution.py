# SPDX-License-Identifier: Apache-2.0
"""Reference solution of a scene at the samples of a horizon, with its uncertainty.

It is the integration of liegroup_core.reference. Its uncertainty is its distance to an integration with a
larger tolerance.
"""

import io
import json
import time
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from liegroup_core.errors import SimulationError
from liegroup_core.mechanism.body_model import initial_state
from liegroup_core.observables.along import Along
from liegroup_core.observables.invariants import momentum_values
from liegroup_core.reference import Distance, Reference, Trajectory

from .configurations import sample_times

# Default horizon: the longest of these, in s, with an uncertainty below KNOWN (relative to the
# characteristic length, and in rad) and at most STEPS steps of the reference. For fast scenes this is
# about a hundred periods; for chaotic scenes, the time over which 1e-9 can be guaranteed.
HORIZONS = tuple(digit * Fraction(10) ** power for power in range(-5, 1) for digit in (1, 2, 5)) + (Fraction(10),)
KNOWN, STEPS = 1e-10, 2_000


class ReferenceSolution(NamedTuple):
    """Reference solution at k times, and scales of its errors."""

    horizon: Fraction  # s
    length: float  # m, characteristic length of the scene
    motion: Trajectory  # of n bodies
    uncertainty: tuple  # largest ones: position m, angle rad, angular velocity rad/s, velocity m/s
    energy: np.ndarray  # (k,) J
    kinetic: float  # largest kinetic energy, J
    seconds: float  # of the reference integration

    @property
    def known(self):
        """Uncertainty of the reference solution as one number, see `scaled`."""
        return scaled(*self.uncertainty[:2], self.length)


def scaled(position, angle, length):
    """Error as one number: the larger of position error / length and attitude error in rad."""
    return float(max(np.max(position) / length, np.max(angle)))


def find_truth(layout, horizon=None, tell=lambda text: None):
    """ReferenceSolution of a scene (layout.Layout) over a horizon in s; None: its default horizon.

    raises SimulationError if there is no reference solution
    """
    began = time.perf_counter()
    length = layout.size
    pose, twist = initial_state(layout.centred)
    if horizon is None:
        horizon, motion, apart = _as_far_as_known(layout, pose, twist, length, tell)
    else:
        tell(f"the reference solution over {float(horizon):g} s")
        times = np.array([float(at) for at in sample_times(horizon)])
        motion, apart = Reference(layout.scene, pose, twist, end=times[-1]).at(times)
    k, n = motion.position.shape[:2]
    poses = np.concatenate([motion.rotation.reshape(k, n, 9), motion.position], axis=2)
    energy, parts, *_ = Along(layout).of(poses, motion.twist)
    return ReferenceSolution(
        horizon,
        length,
        motion,
        tuple(float(part.max()) for part in (apart.position, apart.angle, apart.angular, apart.linear)),
        energy,
        float(parts[:, 0].max()),
        time.perf_counter() - began,
    )


def _as_far_as_known(layout, pose, twist, length, tell):
    """(horizon, Trajectory, Distance) for the longest possible one of HORIZONS."""
    reference = Reference(layout.scene, pose, twist, end=float(HORIZONS[-1]))
    # The samples of all candidate horizons.
    wanted = sorted({at for horizon in HORIZONS for at in sample_times(horizon)})
    kept, best, failure = {}, None, None
    for horizon in HORIZONS:
        tell(f"the reference solution: {float(horizon):g} s, {reference.steps} steps")
        times = [at for at in wanted if at <= horizon and at not in kept]
        try:
            motion, apart = reference.at(np.array([float(at) for at in times]))
        except SimulationError as error:
            failure = error
            break
        kept |= {at: (*(part[i] for part in motion[1:]), *(part[i] for part in apart)) for i, at in enumerate(times)}
        last = [part[-1] for part in apart]
        if best is not None and (scaled(last[0], last[2], length) > KNOWN or reference.steps > STEPS):
            break
        best = horizon
    if best is None:
        raise SimulationError(f"{failure}; the scene is too fast for a default horizon: give a horizon")
    times = sample_times(best)
    columns = [np.array(column) for column in zip(*(kept[at] for at in times))]
    return (best, Trajectory(np.array([float(at) for at in times]), *columns[:3]), Distance(*columns[3:]))


def as_bytes(truth):
    """ReferenceSolution as the bytes of a NumPy file *.npz; `truth_from` is the inverse."""
    stream = io.BytesIO()
    facts = {
        "horizon": str(truth.horizon),
        "length": truth.length,
        "uncertainty": truth.uncertainty,
        "kinetic": truth.kinetic,
        "seconds": truth.seconds,
    }
    np.savez(stream, facts=np.array(json.dumps(facts)), energy=truth.energy, **truth.motion._asdict())
    return stream.getvalue()


def truth_from(path):
    """ReferenceSolution from a file. Raises OSError, ValueError, KeyError, BadZipFile."""
    with np.load(path, allow_pickle=False) as found:
        facts = json.loads(str(found["facts"]))
        return ReferenceSolution(
            Fraction(facts.pop("horizon")),
            motion=Trajectory(*(found[name] for name in Trajectory._fields)),
            energy=found["energy"],
            uncertainty=tuple(facts.pop("uncertainty")),
            **facts,
        )


def momentum_drift(scene, kept, truth, motion):
    """Largest relative drift of a conserved momentum component along a motion.

    kept : from `conserved_momentum`. Returns None if nothing is conserved
    """
    true = truth.motion
    mass = np.array([body.mass for body in scene.bodies])
    inertia = np.array([body.inertia_matrix for body in scene.bodies])
    linear = mass * np.linalg.norm(true.twist[..., 3:], axis=2)
    arm = np.linalg.norm(true.position, axis=2)
    spin = np.linalg.norm(np.einsum("nij,knj->kni", inertia, true.twist[..., :3]), axis=2)
    # Drifts are relative to the sum over the bodies, because a component itself can be zero.
    size = {"N m s": float((arm * linear + spin).sum(axis=1).max()), "N s": float(linear.sum(axis=1).max())}
    worst = None
    for group in kept:
        values = momentum_values(scene, group, motion.rotation, motion.position, motion.twist)
        change = np.abs(values - values[0]).max(axis=0)
        for off, unit in zip(change.tolist(), group.units):
            if size[unit] > 0.0:
                worst = max(worst or 0.0, off / size[unit])
    return worst
