# SPDX-License-Identifier: Apache-2.0
"""Runs with effects that a model may lack: forces along the fitted motion, inputs and numbers of contacts changed."""

from dataclasses import replace

import numpy as np

from liegroup_core.errors import SceneError, SimulationError

AXES = ("x", "y", "z")  # of the world
VARIABLES = ("position", "velocity", "time")  # on which an effort may depend


class Forced:
    """Runs with an effect, as a function of (kind, joint or body or input, size); None where a run fails."""

    def __init__(self, runs, point):
        self._runs, self._point, self._paths = runs, point, {}

    def __call__(self, item):
        kind, of, size = item
        machine, point = self._runs.machine(self._point.values), self._point
        segments, states, extras = self._runs.segments(point), point.states, None
        try:
            if kind == "number":
                return self._runs.with_number(point, of, size)
            if kind in ("scale", "lag"):
                k, *lag = of
                rows = (
                    [segment.inputs[:, k] for segment in segments] if kind == "scale" else self._late(segments, k, *lag)
                )
                unit = np.arange(segments[0].inputs.shape[1]) == k
                changes = [size * np.outer(row, unit) for row in rows]
                segments = [replace(each, inputs=each.inputs + change) for each, change in zip(segments, changes)]
            else:
                pairs = zip(segments, point.states)
                extras = [size * self._extra(machine, *pair, kind, of) for pair in pairs]
                # Without a force in a segment its run is as it was.
                states = [state if extra.any() else None for state, extra in zip(states, extras)]
            return self._runs.along(machine, segments, states, point.halves, point.states, extras)
        except (SimulationError, SceneError):
            return None

    def _extra(self, machine, segment, state, kind, of):
        """(m, n, COLUMNS) change of the wrenches in the parts of a Segment by an effect of unit size."""
        path, steps = self._path(machine, segment, state), np.diff(segment.times)
        if kind == "mass":
            body = list(machine.layout.body_names).index(of)
            # Of the frame at the centre of mass, in the middle of each part, body axes.
            twist, turn = path.twists[:, body], path.poses[:, body, :9].reshape(-1, 3, 3)
            w, v = 0.5 * (twist[1:, :3] + twist[:-1, :3]), 0.5 * (twist[1:, 3:] + twist[:-1, 3:])
            a = np.diff(twist[:, 3:], axis=0) / steps[:, None] + np.cross(w, v)
            change = np.zeros_like(path.wrenches)
            change[:, body, 3:6] = np.array(machine.layout.scene.gravity) @ (0.5 * (turn[1:] + turn[:-1])) - a
            return change
        if kind in AXES:
            body = list(machine.layout.body_names).index(of)
            turn = path.poses[:, body, :9].reshape(-1, 3, 3)[:, AXES.index(kind)]
            change = np.zeros_like(path.wrenches)
            change[:, body, 3:6] = 0.5 * (turn[1:] + turn[:-1])
            return change
        joint = of if isinstance(of, str) else of[0]
        position, velocity, time = self._middle(machine, segment, path, joint).T
        if kind in VARIABLES:
            x = (position, velocity, time)[VARIABLES.index(kind)]
            return ((x >= of[1]) & (x < of[2]))[:, None, None] * machine.effort(joint)
        amount = {
            "coulomb": lambda: -np.sign(velocity),
            "viscous": lambda: -velocity,
            "drag": lambda: -velocity * np.abs(velocity),
            "by_load": lambda: -np.sign(velocity) * self._pressed(path, joint),
            "constant": lambda: np.ones_like(velocity),
            "spring": lambda: -position,
            "wave": lambda: of[2](of[1] * position),
            "armature": lambda: -np.diff(path.joints[:, machine.layout.coordinates.names.index(joint), 1]) / steps,
        }[kind]()
        return amount[:, None, None] * machine.effort(joint)

    @staticmethod
    def _pressed(path, joint):
        """(m,) N, of the force that a joint carries in each part."""
        found = [np.linalg.norm(path.sample(k).reactions[joint][3:]) for k in range(len(path.poses))]
        return 0.5 * (np.array(found[1:]) + found[:-1])

    @staticmethod
    def _late(segments, k, lag):
        """[(m,)] what an input has more in the mean of parts than behind a critically damped lag of a time in s."""
        found, off, rate, before = [], 0.0, 0.0, None
        for segment in segments:
            rows = []
            for u, t in zip(segment.inputs[:, k].tolist(), np.diff(segment.times).tolist()):
                off += 0.0 if before is None else before - u
                slope, decay, before = rate + off / lag, np.exp(-t / lag), u
                end = (off + slope * t) * decay
                rows.append(lag * (off + slope * lag - end - slope * lag * decay) / t)
                off, rate = end, slope * decay - end / lag
            found.append(np.array(rows))
        return found

    def _path(self, machine, segment, state):
        """Path of the fitted run at all times of a Segment."""
        key = segment.start
        if key not in self._paths:
            self._paths[key] = machine.path(segment, state, np.arange(len(segment.times)), halves=self._point.halves)
        return self._paths[key]

    def middles(self, joint):
        """[(m, 3)] position, velocity and time of a joint in the middle of the parts of each segment."""
        machine = self._runs.machine(self._point.values)
        pairs = zip(self._runs.segments(self._point), self._point.states)
        return [self._middle(machine, pair[0], self._path(machine, *pair), joint) for pair in pairs]

    @staticmethod
    def _middle(machine, segment, path, joint):
        x = np.column_stack([path.joints[:, machine.layout.coordinates.names.index(joint)], segment.times])
        return 0.5 * (x[1:] + x[:-1])
