# SPDX-License-Identifier: Apache-2.0
"""Subscriptions to the commands for joints and drives: they are decoded and passed to the simulation."""

from concurrent.futures import wait
from functools import partial

from geometry_msgs.msg import TwistStamped
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from liegroup_sim_ros.serving.joint_command_input import JointCommandInput
from liegroup_sim_ros.serving.joint_input import Jumps
from liegroup_sim_ros.serving.trajectory_input import TrajectoryInput

from .input_topics import InputTopics
from .parameters import NodeParameterError

# Depth of the queues of commands: 0.1 s at 1 kHz. It bounds the memory: messages may have any length.
COMMANDS = 100
DRIVING = 0.5  # s, duration of a velocity from ~/cmd_vel if command_timeout is 0: a robot without commands stops
BUSY = 1.0  # s, longest wait for the present positions: one block of steps takes milliseconds


class JointCommandTopics(InputTopics):
    """Topics for commands: ~/joint_commands, ~/commands, ~/joint_trajectory and ~/cmd_vel.

    Each exists only if the scene has joints that it can command.

    node   : rclpy Node
    layout : Layout of the scene
    values : parameters; command_timeout, command_stamps and command_jump are read for every message
    server : SimulationServer
    qos    : QosOverrides
    Raises NodeParameterError for command_joints that are not joints of the scene.
    """

    def __init__(self, node, layout, values, server, qos):
        super().__init__(node, qos, server)
        self._values = values
        self.input = JointCommandInput(layout, values.motion_time, server)
        self.trajectories = TrajectoryInput(layout, server)
        self._names = tuple(name.strip() for name in values.command_joints.split(",") if name.strip())
        self._check_names()
        if self.input.joints:
            self._subscribe("joint_commands", JointState, self._read, COMMANDS, divides=True)
        if self._names:
            self._subscribe("commands", Float64MultiArray, self._read_array, COMMANDS, is_stamped=False)
        if self.input.follows:
            # A trajectory replaces the previous one, so a long queue of large messages is useless.
            self._subscribe("joint_trajectory", JointTrajectory, self._read_trajectory, 10)
        self._wheels = layout.wheels
        if self._wheels is not None:
            self._subscribe("cmd_vel", TwistStamped, self._read_velocity, 10)

    def _check_names(self):
        for name in self._names:
            if name not in self.input.joints:
                raise NodeParameterError(
                    f"parameter command_joints: {name!r} is not a joint with one coordinate; choose "
                    f"from: {', '.join(self.input.joints) or 'the scene has none'}"
                )
            kind = self._values.command_interface
            if kind == "effort" or name in self.input.driven:
                continue
            if self.input.servos.get(name) is not (kind == "position"):
                raise NodeParameterError(
                    f"parameter command_interface: joint {name!r} takes no {kind} commands: it needs to be "
                    f"driven, or a servo {'with' if kind == 'position' else 'without'} stiffness"
                )
        if len(set(self._names)) < len(self._names):
            raise NodeParameterError("parameter command_joints: a joint occurs twice")

    def _refuse_command(self, text):
        """Count and log a late refusal; called by the simulation thread, like the next method."""
        self._attempt(self.input.refuse_late, text)

    def _refuse_trajectory(self, text):
        self._attempt(self.trajectories.refuse_late, text)

    @property
    def _lasting(self):
        return self._values.command_timeout or None

    @property
    def _jumps(self):
        values = self._values
        if not values.command_jump:
            return None
        if self._server.positions is None:  # the simulation thread has not yet heard of the parameter
            wait([self._server.call("watch", True)], BUSY)
        return Jumps(values.command_jump, self._server.positions or {}, values.trajectory_period)

    def _now_ns(self, asked):
        return asked.stamp_ns if asked else self._server.stamp_ns

    def _push(self, commands, lasting):
        return partial(self._server.push, commands, lasting, self._refuse_command)

    def _read(self, payload, topic, asked):
        lasting = asked.hold if asked else self._lasting
        held, stamped = self._server.inputs_held, self._values.command_stamps
        found = self.input.read(payload, self._now_ns(asked), held, lasting, stamped, self._jumps, topic)
        return self._push(found, lasting)

    def _read_array(self, payload, *_):
        held, kind = self._server.inputs_held, self._values.command_interface
        return self._push(self.input.read_array(payload, self._names, kind, held, self._jumps), self._lasting)

    def _read_velocity(self, payload, _, asked):
        message = deserialize_message(payload, TwistStamped)
        stamp, twist = message.header.stamp, message.twist
        lasting = asked.hold if asked else self._lasting or DRIVING
        commands = self.input.read_rates(
            self._wheels.at(twist.linear.x, twist.angular.z),
            stamp.sec * 10**9 + stamp.nanosec if self._values.command_stamps else 0,
            self._now_ns(asked),
            self._server.inputs_held,
            lasting,
        )
        return self._push(commands, lasting)

    def _read_trajectory(self, payload, _, asked):
        stamped = self._values.command_stamps
        trajectory = self.trajectories.read(payload, self._now_ns(asked), stamped, self._jumps, asked is not None)
        return partial(self._server.follow, trajectory, self._refuse_trajectory) if trajectory else lambda: None

    def figures(self):
        """Figures of the topics for the diagnostics; none without the topics."""
        return {
            **(self.input.figures() if self.input.joints else {}),
            **(self.trajectories.figures() if self.input.follows else {}),
        }
