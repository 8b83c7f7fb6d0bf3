# SPDX-License-Identifier: Apache-2.0
"""Messages with the state of all bodies or joints at one instant, from a Sample.

Each function except the first takes a scene's Layout, the frame id of the world and the prefix of
the frame ids of bodies. It returns [(topic, type, encode)], one entry per topic;
`encode(stamp_ns, sample)` returns the serialized message. Poses are in the world frame. Twists are
body twists: the velocity of the body frame's origin and the angular velocity, in body axes.
"""

import math

import numpy as np

from liegroup_core.fields.frames import Frame
from liegroup_core.scene.consistency import resolve_frames
from liegroup_core.scene.names import WORLD

from . import arrays, topics
from .cdr import Template, stamp
from .codecs import PoseStampedCodec, TwistStampedCodec, WrenchStampedCodec, pack_stamp
from .commands import JOINT_STATE, joint_labels, joint_state_template
from .description import unheld_links
from .estimates import covariance, variances
from .links import link_of_body, links_and_joints, placer, places_of
from .sensors import ODOMETRY, odometry_template, sensors

REACTION = "_reaction"  # ending of the frame ids of reactions
_POSE, _BODY = 7 * 8, 13 * 8  # bytes of a pose, and of a body, in Sample.rows


def motion(bodies, own, world_frame, frame_prefix=""):
    """([Topic], function (stamp_ns, sample) -> their serialized messages): poses and twists of all bodies.

    own : those with topics of their own; unless these are all, two topics have all bodies, see arrays.py
    """
    encode_pose = PoseStampedCodec(world_frame).encode_packed
    pose_array, twist_array = arrays.pose_encoder(len(bodies), world_frame), arrays.twist_encoder(bodies)
    has_arrays = len(own) < len(bodies)
    of_own = [
        (TwistStampedCodec(frame_prefix + body).encode_packed, k * _BODY, k * _BODY + _POSE, (k + 1) * _BODY)
        for k, body in enumerate(bodies)
        if body in own
    ]

    def encode(stamp_ns, sample):
        # Bytes of all bodies at once: packing single numbers costs several times more.
        time, found, numbers = pack_stamp(stamp_ns), [], sample.rows
        rows = numbers.tobytes()
        if has_arrays:
            found = [pose_array(time, numbers[:, :7].tobytes()), twist_array(numbers[:, 7:].tobytes())]
        for encode_twist, first, middle, end in of_own:
            found += encode_pose(time, rows[first:middle]), encode_twist(time, rows[middle:end])
        return found

    of_all = [topics.POSES, topics.TWISTS] if has_arrays else []
    return [*of_all, *(kind(body) for body in bodies if body in own for kind in (topics.pose, topics.twist))], encode


def odometry(layout, world_frame, frame_prefix=""):
    """nav_msgs/Odometry of every body: pose and body twist.

    Variances are those of estimates.py, the same for all three axes.
    """

    def of_body(body):
        template = odometry_template(world_frame, frame_prefix + body)
        return lambda stamp_ns, sample: template.pack(stamp(stamp_ns), *_with_covariances(sample, body))

    return [(f"~/{body}/odometry", ODOMETRY, of_body(body)) for body in layout.body_names]


def poses_with_covariance(layout, world_frame, frame_prefix=""):
    """geometry_msgs/PoseWithCovarianceStamped of every body: pose, with variances as `odometry`."""

    def of_body(body):
        template = Template()
        template.header(world_frame)
        template.slot("7d")
        template.slot("36d")
        return lambda stamp_ns, sample: template.pack(stamp(stamp_ns), *_with_covariances(sample, body)[:2])

    return [
        (f"~/{body}/pose_with_covariance", "geometry_msgs/msg/PoseWithCovarianceStamped", of_body(body))
        for body in layout.body_names
    ]


def velocities(layout, world_frame, frame_prefix=""):
    """geometry_msgs/VelocityStamped of every body: body twist relative to the world."""

    def of_body(body):
        template = Template()
        template.header(frame_prefix + body)
        template.string(frame_prefix + body)
        template.string(world_frame)
        template.slot("6d")
        return lambda stamp_ns, sample: template.pack(stamp(stamp_ns), _twist(sample, body))

    return [(f"~/{body}/velocity", "geometry_msgs/msg/VelocityStamped", of_body(body)) for body in layout.body_names]


def joint_states(layout, world_frame, frame_prefix=""):
    """sensor_msgs/JointState of the joints with one angle or displacement; [] if there are none.

    Joints of a robot have the names in its file; joints that do not move are included, with velocity 0.
    Efforts are those of servos and of acting commands.

    NaN means no effort, as in ros2_control's joint_state_broadcaster. An empty sequence at the end of
    the message does not work, because readers accept different padding there: rosbags accepts at most
    3 bytes more than ROS sends, pybag-sdk needs up to 4. Without joints there is no topic for the same reason.
    """
    names, robot = layout.coordinates.names, layout.scene.robot
    still = {} if robot is None else robot.still
    labels = [*joint_labels(names, robot), *still]
    if not labels:
        return []
    template = joint_state_template(labels)
    held, rest = list(still.values()), [0.0] * len(still)
    idle = [math.nan] * len(labels)

    def encode(stamp_ns, sample):
        coordinates, efforts = sample.joint_coordinates, sample.all_efforts
        effort = idle
        if efforts:
            effort = [efforts.get(name, math.nan) for name in names] + idle[len(names) :]
        return template.pack(
            stamp(stamp_ns),
            [coordinates[name][0] for name in names] + held,
            [coordinates[name][1] for name in names] + rest,
            effort,
        )

    return [("~/joint_states", JOINT_STATE, encode)]


def reactions(layout, world_frame, frame_prefix=""):
    """geometry_msgs/WrenchStamped of every joint: `Sample.reactions`, NaN where undetermined.

    Also of every spring, motor and servo at a joint: `Sample.force_efforts`, on the child. The frame
    is the child's joint frame, `JOINT_reaction`; see `fixed_frames`. ~/BODY/wrench is an input: a joint
    or force with the name of a body has ~/NAME_reaction/wrench. Raises ValueError if that is taken, too.
    """
    joints, forces = [joint.name for joint in layout.scene.joints], layout.joint_forces
    labels = _labels(layout, (*joints, *forces))

    def of_joint(name):
        codec = WrenchStampedCodec(f"{frame_prefix}{name}{REACTION}")
        return lambda stamp_ns, sample: codec.encode(stamp_ns, sample.reactions[name])

    def of_force(name):
        codec = WrenchStampedCodec(f"{frame_prefix}{forces[name].joint}{REACTION}")
        before, after = ((0.0,) * k for k in ((2, 3) if forces[name].joint_moves == "turns" else (5, 0)))
        return lambda stamp_ns, sample: codec.encode(stamp_ns, (*before, sample.force_efforts[name], *after))

    encoders = {name: of_joint(name) for name in joints}
    encoders |= {name: of_force(name) for name in forces}
    return [(f"~/{labels[name]}/wrench", WrenchStampedCodec.TYPE, encode) for name, encode in encoders.items()]


def impulses(layout, frame_prefix=""):
    """[(topic, message type, function (stamp in ns, impulse (6,)) -> message)] of all joints.

    geometry_msgs/WrenchStamped in N m s and N s: impulse of a joint on its child at an impact. Names
    and frames are those of `reactions`.
    """
    joints = [joint.name for joint in layout.scene.joints]
    labels = _labels(layout, joints)
    return [
        (
            f"~/{labels[name]}/impulse",
            WrenchStampedCodec.TYPE,
            WrenchStampedCodec(f"{frame_prefix}{name}{REACTION}").encode,
        )
        for name in joints
    ]


def contacts(layout, world_frame, frame_prefix=""):
    """geometry_msgs/WrenchStamped of every contact on its body: `Sample.contact_wrenches`, in the frame of the body.

    Names are those of `reactions`.
    """

    def of_contact(contact):
        codec = WrenchStampedCodec(f"{frame_prefix}{contact.body}")
        return lambda stamp_ns, sample: codec.encode(stamp_ns, sample.contact_wrenches[contact.name])

    found = {force.name: force for force in layout.scene.forces if force.type == "contact"}
    labels = _labels(layout, found)
    return [(f"~/{labels[name]}/wrench", WrenchStampedCodec.TYPE, of_contact(each)) for name, each in found.items()]


def _labels(layout, names):
    """{joint or force: its name in topics}. Raises ValueError if that is taken."""
    labels = {name: f"{name}{REACTION}" if name in layout.body_names else name for name in names}
    taken = {*layout.body_names, *(each.name for each in (*layout.scene.joints, *layout.scene.forces))}
    taken |= {sensor.name for sensor in layout.scene.sensors}
    for name, label in labels.items():
        if label != name and label in taken:
            raise ValueError(
                f"~/{label}/wrench is for the joint or force {name}, which has the name of a body: give "
                f"{label} another name"
            )
    return labels


def fixed_frames(layout, frame_prefix=""):
    """Serialized tf2_msgs/TFMessage of the frames that are fixed in links: of joints and sensors.

    JOINT_reaction is the joint frame of the child, also used for a force_torque sensor without a frame.
    """
    scene = layout.scene
    of_child = {joint.name: (joint.child, frame) for joint, (_, frame) in zip(scene.joints, resolve_frames(scene))}
    frames = {f"{joint}{REACTION}": place for joint, place in of_child.items()}
    for sensor in scene.sensors:
        if sensor.type == "force_torque":
            child, frame = of_child[sensor.joint]
            frames[sensor.name] = child, sensor.frame.pose if sensor.frame else frame
        elif hasattr(sensor, "frame"):
            frames[sensor.name] = sensor.body, (sensor.frame or Frame()).pose
    links = link_of_body(scene)
    parents = [frame_prefix + links[body] for body, _ in frames.values()]
    places = places_of(np.array([frame for _, frame in frames.values()]).reshape(-1, 4, 4))
    return _tf_encoder(parents, [frame_prefix + name for name in frames])(0, places)


def _tf_encoder(parents, children):
    """Function (stamp_ns, places (k, 7) of the children) -> serialized TFMessage."""
    template = Template()
    template.put("I", len(children))
    for parent, child in zip(parents, children):
        template.header(parent)
        template.string(child)
        template.slot("7d")

    def encode(stamp_ns, places):
        time = stamp(stamp_ns)
        return template.pack(*(slot for place in places for slot in (time, place)))

    return encode


def transforms(layout, world_frame, frame_prefix="", which="all"):
    """tf2_msgs/TFMessage: transforms from the world frame to the frames of links and bodies.

    which : one of TF_LINKS: all links, or those that robot_state_publisher does not publish. In both
            cases, a body whose link has another name also has a frame with its own name
    """
    scene = layout.scene
    links, _ = links_and_joints(scene)
    if which == ROOTS:
        fixed = (WORLD, np.eye(4))
        links = {name: links.get(name, fixed) for name in unheld_links(scene) if frame_prefix + name != world_frame}
    links |= {
        body: (body, np.eye(4)) for body, link in link_of_body(scene).items() if link != body and body not in links
    }
    if not links:
        return []
    encode = _tf_encoder([world_frame] * len(links), [frame_prefix + name for name in links])
    places = placer(layout, [body for body, _ in links.values()], [pose for _, pose in links.values()])
    return [("/tf", "tf2_msgs/msg/TFMessage", lambda stamp_ns, sample: encode(stamp_ns, places(sample)))]


# Values of the parameter tf_links.
ROOTS = "roots"
TF_LINKS = ("all", ROOTS)

# Optional topics: {parameter of the rate: (function above, topic as in the documentation)}. The node
# declares the parameters and publishes the topics from this table.
OPTIONAL = {
    "odometry_rate": (odometry, "~/BODY/odometry"),
    "pose_with_covariance_rate": (poses_with_covariance, "~/BODY/pose_with_covariance"),
    "velocity_rate": (velocities, "~/BODY/velocity"),
    "joint_state_rate": (joint_states, "~/joint_states"),
    "tf_rate": (transforms, "/tf"),
    "reaction_rate": (reactions, "~/JOINT/wrench"),
    "contact_rate": (contacts, "~/CONTACT/wrench"),
    "sensor_rate": (sensors, "~/SENSOR/..."),
}


def _with_covariances(sample, body):
    """Pose, its covariance (36,), twist, its covariance (36,)."""
    position, attitude, linear, angular = variances(sample, body)
    return (_pose(sample, body), covariance(position, attitude), _twist(sample, body), covariance(linear, angular))


def _pose(sample, body):
    """[x, y, z, qx, qy, qz, qw], m, world frame."""
    return [*sample.positions[body].tolist(), *sample.quaternions[body].tolist()]


def _twist(sample, body):
    """[vx, vy, vz, wx, wy, wz], m/s and rad/s, body axes; linear first, as in the messages."""
    twist = sample.twists[body].tolist()
    return twist[3:] + twist[:3]
