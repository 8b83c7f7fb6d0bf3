# SPDX-License-Identifier: Apache-2.0
"""Client of a node that takes commands for joints, for the tests."""

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from node_process import COMPILING, stamp_ns
from sensor_msgs.msg import JointState

STEP = 1e-3  # s, of the node


class Commanded:
    """Running node with a publisher of commands; joint states and applied wrenches as they come."""

    def __init__(self, client, node):
        self.client, self.node = client, node
        self.states = client.listen(f"{node}/joint_states", JointState)
        self.applied = client.listen(f"{node}/applied_wrench", WrenchStamped)
        self.figures = client.listen(f"{node}/state", DiagnosticArray)
        self.publisher = client.node.create_publisher(JointState, f"{node}/joint_commands", 100)
        client.until(self.publisher.get_subscription_count, COMPILING, "the subscription")

    def command(self, stamp=0, **fields):
        message = JointState(**fields)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        self.publisher.publish(message)

    def figure(self, name):
        return int({v.key: v.value for v in self.figures[-1].status[0].values}[name])

    def now(self):
        return stamp_ns(self.states[-1].header.stamp)

    def steps(self, count):
        """Take steps while paused; the joint state after them."""
        assert self.client.set(self.node, step_count=count).successful
        self.client.spin(0.1)  # commands have arrived before it is asked for steps
        before = self.now()
        assert self.client.call(f"{self.node}/step").success
        end = before + round(count * STEP * 1e9)
        return self.client.until(
            lambda: next(
                (s for s in reversed(self.states) if stamp_ns(s.header.stamp) == end), None
            )
        )


def coordinates(state):
    return list(zip(state.position, state.velocity))
