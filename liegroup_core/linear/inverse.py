# SPDX-License-Identifier: Apache-2.0
"""Inverse dynamics: the efforts that a motion needs, in loops and with redundant actuation too.

At every instant the mechanism is put at given positions, rates and accelerations of its independent
coordinates, and closed. The accelerations are affine in the efforts u,

    z'' = a + B u ,

so that those of the smallest sum of squares follow from B; where friction depends on the load, by iteration. What
the efforts cannot produce remains as a residual acceleration. Dry friction opposes the rates and is zero at rest. Where
a coordinate rests at a rigid stop, the stop pushes as far as that makes efforts smaller.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from liegroup_core.errors import SceneError, SimulationError

from .channels import InputChannels
from .coordinates import Coordinates
from .friction import Stops
from .probe import Probe, refuse_sliding
from .trim import undetermined

LARGEST = 0.2  # rad, or share of the mechanism's size, in a step towards a far position
REACHED, MOST_STEPS = 1e-9, 1000
SAME, MOST_REPEATS = 1e-12, 30
FIRST = 1e6  # weight of the accelerations that efforts cannot produce, against the efforts


@dataclass(frozen=True, eq=False)
class InverseDynamics:
    """Efforts of a motion.

    times     : (k,) s
    inputs    : names of the efforts
    efforts   : (k, p) N m or N
    rates     : (k, p) rates of their joints, rad/s or m/s
    residual  : (k,) largest acceleration that the efforts cannot produce, rad/s^2 or m/s^2
    undetermined : names of efforts that can change together without effect, at any of the times
    """

    times: np.ndarray
    inputs: tuple
    efforts: np.ndarray
    rates: np.ndarray
    residual: np.ndarray
    undetermined: tuple

    @property
    def power(self):
        """(k, p) W."""
        return self.efforts * self.rates

    @property
    def energy(self):
        """(p,) J that each effort gives to the mechanism: integral of its power by Simpson's rule."""
        if len(self.times) < 2:
            return np.zeros(len(self.inputs))
        return scipy.integrate.simpson(self.power, x=self.times, axis=0)


def inverse_dynamics(simulation, times, positions, rates, accelerations, joints, inputs=None):
    """InverseDynamics of a motion of a simulation, which does not change.

    times  : (k,) s
    positions, rates, accelerations : (k, m) of the joints, rad or m
    joints : names of the m independent coordinates
    inputs : names of efforts, see channels.py; None: those of the joints
    Raises SceneError for unknown or dependent names and for wheels, which have no positions of their own,
    SimulationError where the loops cannot be closed, beyond a stop, and where states of laws act. Taut cables stay so.
    Accuracy: test/verification/test_linear.py.
    """
    probe = Probe(simulation)
    refuse_sliding(probe, "inverse dynamics")
    joints_of_motions(probe)
    if not joints:
        raise SceneError("inverse dynamics needs at least one independent joint")
    names = [f"{joint}.effort" for joint in joints] if inputs is None else inputs
    channels = InputChannels(probe, names, kinds=("efforts",))
    released, stops = probe.modes, Stops(probe)
    coordinates = Coordinates(probe, joints)
    layout = probe.layout
    lengths = coordinates.scales
    actuated = [name.removesuffix(".effort") for name in channels.names]
    efforts, speeds, residuals, loose = [], [], [], []
    for time, q, v, a in zip(times, positions, rates, accelerations):
        probe.go_to_time(time)
        _go(probe, joints, q, v, lengths)
        _refuse_states(probe, time)
        stops.follow()
        if beyond := stops.beyond():
            raise SimulationError(f"the motion is beyond a stop at {time:.9g} s: {beyond}")
        probe.oppose(released)
        coordinates = Coordinates(probe, joints)
        way = sum(each * coordinates.neighbour(k, 1.0, rate=True) for k, each in enumerate(coordinates.signs * a))
        u, B, rest = _efforts(probe, coordinates, channels, np.asarray(a) / lengths, lengths, stops.pushing(way))
        efforts.append(u)
        residuals.append(np.abs(rest * lengths).max(initial=0.0))
        _, pose, twist = probe.slopes()
        found = layout.coordinates.at(pose, twist, probe.angles)
        speeds.append([found[name][1] for name in actuated])
        loose += [name for name in undetermined(B * lengths[:, None], channels.names) if name not in loose]
    return InverseDynamics(
        np.asarray(times, dtype=float),
        tuple(channels.names),
        np.array(efforts),
        np.array(speeds),
        np.array(residuals),
        tuple(loose),
    )


def joints_of_motions(probe):
    """Names of the freedoms whose positions can determine the pose, with all stops and friction released.

    Raises SceneError where joints with one coordinate cannot.
    """
    if probe.layout.rolls:
        raise SceneError("inverse dynamics needs joints whose positions determine the pose: wheels that roll do not")
    probe.release(stops=True)
    joints = [freedom.name for freedom in probe.layout.freedoms if freedom.is_of_joint]
    if others := [name for name in Coordinates(probe, preferred=joints).names if name not in joints]:
        raise SceneError(
            f"inverse dynamics needs joints with one coordinate that determine the pose: here {', '.join(others)} move "
            "freely"
        )
    return joints


def _efforts(probe, coordinates, channels, wanted, lengths, pushing):
    """Efforts, their effects B on the accelerations, and what is missing of those wanted; divided by lengths.

    pushing : (k,) see Stops.pushing
    """
    rows, kept = probe.freedoms + coordinates.independent, probe.modes if len(pushing) else None
    at_stops, signs = np.flatnonzero(pushing), pushing[pushing != 0.0]

    def accelerations(x):
        u, f = np.split(x, [len(channels)])
        if len(f):
            modes = kept.copy()
            modes[at_stops, 0], modes[at_stops, 1], modes[at_stops, 4] = 2.0, 0.0, signs * f
            probe.modes = modes
        return coordinates.signs * probe.slopes(None, channels.applied(u))[0][rows] / lengths

    x = np.zeros(len(channels) + len(at_stops))
    for _ in range(MOST_REPEATS):
        now, before = accelerations(x), x
        effects = np.array([accelerations(x + one) - now for one in np.eye(len(x))]).reshape(len(x), len(rows)).T
        B, F = np.split(effects, [len(channels)], axis=1)
        x = _least(B, F, wanted - now + effects @ x)
        if not probe.has_loads or np.abs(x - before).max(initial=0.0) <= SAME * np.abs(x).max(initial=0.0):
            break
    rest = wanted - accelerations(x)
    if len(at_stops):
        probe.modes = kept
    return x[: len(channels)], B, rest


def _least(B, F, right):
    """u and f >= 0 whose effects B u + F f are nearest to the right side, and of these the least u."""
    inverse, f = np.linalg.pinv(B, rcond=1e-10), np.zeros(F.shape[1])
    if len(f):
        across = FIRST * max(float(np.linalg.norm(inverse)), 1.0) * (np.eye(len(right)) - B @ inverse)
        both = np.vstack([across, inverse])
        f = scipy.optimize.nnls(both @ F, both @ right)[0]
    return np.concatenate([np.linalg.lstsq(B, right - F @ f, rcond=1e-10)[0], f])


def _go(probe, joints, q, v, lengths):
    """Put the closed mechanism at positions and rates of its independent joints."""
    for _ in range(MOST_STEPS):
        coordinates = Coordinates(probe, joints)
        _, pose, twist = probe.closed()
        found = probe.layout.coordinates.at(pose, twist, probe.angles)
        way = np.asarray(q) - np.array([found[name][0] for name in joints])
        turns = np.array([unit == "rad" for unit in coordinates.units])
        way[turns] = (way[turns] + np.pi) % (2.0 * np.pi) - np.pi
        far = np.abs(way / lengths).max(initial=0.0)
        probe.go_to(coordinates.at(coordinates.signs * way * min(1.0, LARGEST / far if far > 0.0 else 1.0)))
        if far <= REACHED:
            break
    else:
        raise SimulationError(f"the positions {np.asarray(q).tolist()} of {', '.join(joints)} are not reached")
    coordinates = Coordinates(probe, joints)
    states = np.zeros(len(coordinates.moving) - len(joints))  # of laws, the last ones
    probe.go_to(coordinates.with_rates(np.concatenate([v, states])))


def _refuse_states(probe, time):
    """Raise SimulationError if a state of a law acts: what it is at a time follows from the motion before."""
    acts = probe.acts
    names = dict.fromkeys(probe.layout.freedoms[k].name.partition(".")[0] for k in probe.state_freedoms if acts[k])
    if names:
        raise SimulationError(
            f"inverse dynamics needs forces that follow from the pose and the rates: at t = {time:.9g} s the states of "
            f"{', '.join(names)} act"
        )
