# SPDX-License-Identifier: Apache-2.0
"""Entities of simulation_interfaces: the bodies of the scene, with their states in world axes."""

import numpy as np

from liegroup_core import SimulationError
from liegroup_core.fields.values import suggestion
from liegroup_core.lie.groups import SO3
from liegroup_sim_ros.serving.counted_input import bounded
from liegroup_sim_ros.serving.simulation_commands import CommandError

from .standard_codes import FAILED, INVALID_POSE, NOT_FOUND, NOT_SUPPORTED, Refused

# Largest difference of a quaternion's norm from 1: single precision, or digits written by hand.
NOT_UNIT = 1e-3


class Entities:
    """Callbacks of the services about entities.

    ask          : coroutine function (command, *arguments) -> result: AnsweringNode.ask
    world_frame  : frame id of poses, twists and accelerations
    entity_state : class of the message EntityState
    """

    def __init__(self, ask, world_frame, entity_state):
        self._ask, self._world_frame, self._entity_state = ask, world_frame, entity_state

    async def get_entities(self, request, response):
        """Names of the bodies whose whole names match the filter."""
        response.entities = _selected(await self._moment(), request.filters)

    async def get_entities_states(self, request, response):
        """States of the bodies that match the filter."""
        moment = await self._moment()
        names = _selected(moment, request.filters)
        response.states = self._states(moment, names)
        response.entities = names

    async def get_entity_state(self, request, response):
        """State of one body."""
        moment = await self._moment()
        _check_name(moment, request.entity)
        (response.state,) = self._states(moment, [request.entity])

    async def set_entity_state(self, request, response):
        """Set pose, twist or both of one body; the other bodies follow through their joints."""
        moment, body, state = await self._moment(), request.entity, request.state
        _check_name(moment, body)
        # Versions before 2.1 have no flags: pose and twist are set.
        sets = {name: getattr(request, f"set_{name}", True) for name in ("pose", "twist")}
        if getattr(request, "set_acceleration", False):
            raise Refused(NOT_SUPPORTED, "accelerations follow from the forces: set pose and twist, and apply a wrench")
        if not any(sets.values()):
            raise Refused(FAILED, "nothing to set: set_pose and set_twist are false")
        frame = state.header.frame_id
        if frame not in ("", self._world_frame):
            raise Refused(
                NOT_SUPPORTED, f"frame_id {frame!r} is not supported: use {self._world_frame!r}, or leave it empty"
            )
        pose = _pose(state.pose) if sets["pose"] else moment.sample.poses[body]
        twists = {body: _twist(state.twist, pose[:3, :3])} if sets["twist"] else {}
        poses = {body: pose} if sets["pose"] else {}
        try:
            return await self._ask("place", poses, twists, {}, f"{_listed(sets)} of {body}")
        except CommandError as error:
            # There is no code for a twist that the joints do not permit: FAILED, and the text says so.
            at_pose = sets["pose"] and "velocities" not in str(error)
            raise Refused(INVALID_POSE if at_pose else FAILED, str(error)) from None

    async def _moment(self):
        return await self._ask("sample")

    def _states(self, moment, names):
        """EntityStates of bodies."""
        sample = moment.sample
        try:
            _ = sample.accelerations
        except SimulationError as error:
            raise Refused(FAILED, str(error)) from None
        return [self._entity(moment.stamp_ns, sample, body) for body in sample.body_names if body in names]

    def _entity(self, stamp_ns, sample, body):
        state = self._entity_state()
        state.header.frame_id = self._world_frame
        state.header.stamp.sec, state.header.stamp.nanosec = divmod(stamp_ns, 10**9)
        rotation, twist = sample.poses[body][:3, :3], sample.twists[body]
        acceleration = sample.accelerations[body]
        for target, names, values in (
            (state.pose.position, "xyz", sample.positions[body]),
            (state.pose.orientation, "xyzw", sample.quaternions[body]),
            (state.twist.angular, "xyz", rotation @ twist[:3]),
            (state.twist.linear, "xyz", rotation @ twist[3:]),
            (state.acceleration.angular, "xyz", rotation @ acceleration[:3]),
            (state.acceleration.linear, "xyz", rotation @ acceleration[3:]),
        ):
            for name, value in zip(names, values):
                setattr(target, name, float(value))
        return state


def _selected(moment, filters):
    """Names of the bodies whose whole names match a filter, in the order of the scene."""
    if len(filters.categories) or len(filters.tags.tags) or filters.bounds.type:
        raise Refused(NOT_SUPPORTED, "bodies have names only: filter by name")
    names = moment.sample.body_names
    matches = _matcher(filters.filter) if filters.filter else bool
    return [body for body in names if matches(body)]


def _matcher(expression):
    """Function that tests in linear time whether a whole text matches a regular expression."""
    try:
        import re2
    except ImportError:
        raise Refused(NOT_SUPPORTED, "filters need the package google-re2: pip install google-re2") from None
    options = re2.Options()
    options.log_errors = False
    try:
        return re2.compile(expression, options).fullmatch
    except re2.error as error:
        raise Refused(FAILED, f"filter {expression!r:.60}: {error!s:.100}") from None


def _check_name(moment, body):
    names = moment.sample.body_names
    if body not in names:
        raise Refused(NOT_FOUND, f"unknown entity {body!r:.60}; {suggestion(body[:60], list(names))}")


def _listed(sets):
    return " and ".join(name for name, is_set in sets.items() if is_set)


def _numbers(message, names):
    return np.array([getattr(message, name) for name in names], dtype=float)


def _pose(message):
    """(4, 4) of a geometry_msgs/Pose."""
    position, quaternion = _numbers(message.position, "xyz"), _numbers(message.orientation, "xyzw")
    norm = np.linalg.norm(quaternion)
    if not bounded(position):
        raise Refused(INVALID_POSE, f"the position is not finite or too large: {position.tolist()}")
    if not abs(norm - 1.0) <= NOT_UNIT:
        raise Refused(INVALID_POSE, f"the quaternion {quaternion.tolist()} has norm {norm:g}, not 1")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = SO3.from_quaternion(quaternion / norm), position
    return pose


def _twist(message, rotation):
    """(6,) in body axes of a geometry_msgs/Twist in world axes."""
    twist = np.concatenate([_numbers(message.angular, "xyz"), _numbers(message.linear, "xyz")])
    if not bounded(twist):
        raise Refused(FAILED, f"the twist is not finite or too large: {twist.tolist()}")
    return (twist.reshape(2, 3) @ rotation).ravel()
