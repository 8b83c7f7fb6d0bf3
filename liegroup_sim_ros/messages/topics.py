# SPDX-License-Identifier: Apache-2.0
"""Topics that are in every recording of a run: name, message type, quality of service.

The node publishes and records them; `liegroup_sim run` records the same ones, without those that
need a clock. ~/robot_description is not recorded. Optional topics, each encoded by one function, are
in samples.py and markers.py.
"""

from typing import NamedTuple

from . import arrays, description, diagnostics, estimates, inputs, joint_modes, law_states, machine, matrices
from .codecs import ClockCodec, LogCodec, PoseStampedCodec, TwistStampedCodec
from .commands import ARRAY, JOINT_STATE


class Topic(NamedTuple):
    """A topic; a name that begins with "~/" is relative to the node."""

    name: str
    type: str
    qos: str = "reliable"  # as in schemas.qos_profile
    depth: int = 10

    def resolved(self, node):
        """Fully qualified name for a node with the given fully qualified name."""
        return node + self.name[1:] if self.name.startswith("~") else self.name


def pose(body):
    """Pose of a body in the world frame."""
    return Topic(f"~/{body}/pose", PoseStampedCodec.TYPE)


def twist(body):
    """Body twist of a body."""
    return Topic(f"~/{body}/twist", TwistStampedCodec.TYPE)


# All bodies, in the order of BODIES: one text with their names, separated by spaces.
POSES = Topic("~/poses", arrays.TYPE)
TWISTS = Topic("~/twists", matrices.TYPE)
BODIES = Topic("~/bodies", description.TYPE, "transient_local", 1)
SCENE = Topic("~/scene", description.TYPE, "transient_local", 1)  # its text, as in a recording
# Bodies that all have topics of their own by default. From here on these would take more CPU time than the rest of the
# node: 14 instead of 7 % of a core at 100 Hz, see the part `bodies` of benchmarks/node.py.
MOST_OWN = 100


def own_by_default(bodies):
    """Those of the bodies that have topics of their own by default: all, or none in a large scene."""
    return bodies if len(bodies) <= MOST_OWN else ()


def of_motion(bodies, own, resolve):
    """{"pose": {body: resolved topic}, "twist": {body: resolved topic}} for the settings of a recording.

    own     : bodies with topics of their own; unless these are all, ~/poses and ~/twists have all bodies
    resolve : function Topic -> resolved name
    """
    of_all = len(own) < len(bodies)
    return {
        "pose": {body: resolve(POSES if of_all else pose(body)) for body in bodies},
        "twist": {body: resolve(TWISTS if of_all else twist(body)) for body in bodies},
    }


# Late subscribers receive the commands that act; many may arrive at one step.
INPUTS = Topic("~/inputs", inputs.TYPE, "transient_local", 1000)
# Each message has all servos: late subscribers need the last one only.
SERVO_TARGETS = Topic("~/servo_targets", JOINT_STATE, "transient_local", 10)
MOTIONS = Topic("~/motions", ARRAY, "transient_local", 10)  # each message has all driven joints
# Each message has all joints with stops or friction.
# Deep, because impacts come in bursts and each has a message.
JOINT_MODES = Topic("~/joint_modes", joint_modes.TYPE, "transient_local", 100)
IMPULSES_KEPT = 100  # messages of ~/JOINT/impulse: impacts come in bursts
EVENTS = Topic("~/events", LogCodec.TYPE, "transient_local", 50)
MACHINE = Topic("~/machine", machine.TYPE)  # beside a real machine
STATIC_TRANSFORMS = Topic("/tf_static", "tf2_msgs/msg/TFMessage", "transient_local", 1)
DESCRIPTION = Topic("~/robot_description", description.TYPE, "transient_local", 1)
CLOCK = Topic("/clock", ClockCodec.TYPE, depth=1)
STATE = Topic("~/state", diagnostics.TYPE)
ERRORS = Topic("~/errors", estimates.TYPE)  # with the samples, if there is an estimate
LAWS = Topic("~/laws", law_states.TYPE)  # with the samples, if laws have states
DIAGNOSTICS = Topic("/diagnostics", diagnostics.TYPE)
