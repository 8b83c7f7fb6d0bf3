# SPDX-License-Identifier: Apache-2.0
"""Controller in lockstep with a simulation node: one answer to each of its states, at exact periods.

    controller = Controller(node, 1000.0, [("/sim_node/joint_states", JointState)],
                            ("/sim_node/joint_commands", JointState), compute)

The node runs with the parameter lockstep:=joint_commands@1000.
"""

from fractions import Fraction
from functools import partial

from rclpy.clock import Clock, ClockType

from liegroup_core.forces.instants import NS, nearest_whole

# s of wall time without a state after which that is logged, and between two looks; a stop of this process is one look
QUIET, LOOK = 0.4, 0.1


class Controller:
    """Publisher of answers.

    node    : rclpy Node, whose executor calls
    rate    : Hz, as in the parameter lockstep
    states  : [(topic, message class with a header)] that make a state
    answer  : (topic, message class with a header)
    compute : function of the messages of a state, all of one time stamp, that returns the answer. It is called once
              for each time stamp that is a multiple of the period; a state that comes again gets the same answer
    """

    def __init__(self, node, rate, states, answer, compute):
        self._node, self._compute = node, compute
        periods, seconds = Fraction(rate).limit_denominator(10**6).as_integer_ratio()
        self._period = seconds * NS, periods  # ns, a ratio
        self._latest, self._answered, self._message = [None] * len(states), None, None
        self._publisher = node.create_publisher(answer[1], answer[0], 10)
        for k, (topic, kind) in enumerate(states):
            node.create_subscription(kind, topic, partial(self._take, k), 10)
        self._looks, self._said = 0, None  # looks since the last state
        node.create_timer(LOOK, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _take(self, k, message):
        stamp = message.header.stamp
        self._latest[k], self._looks = message, 0
        if any(each is not message and (each is None or each.header.stamp != stamp) for each in self._latest):
            return
        stamp_ns, (period, parts) = stamp.sec * NS + stamp.nanosec, self._period
        if nearest_whole(nearest_whole(stamp_ns * parts, period) * period, parts) != stamp_ns:
            return
        if stamp_ns != self._answered:
            self._message, self._answered = self._compute(*self._latest), stamp_ns
            self._message.header.stamp = stamp
        self._publisher.publish(self._message)

    def _look(self):
        self._looks += 1
        if self._looks * LOOK > QUIET and self._said != self._answered:  # the first look may follow a state at once
            self._said, last = self._answered, self._answered / NS
            self._node.get_logger().warning(f"no state of the simulation for {QUIET:g} s, answered last: {last:.9f} s")
