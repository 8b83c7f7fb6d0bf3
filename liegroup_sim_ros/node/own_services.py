# SPDX-License-Identifier: Apache-2.0
"""Services without a standard type: set a state, apply a wrench at a point, pull at a point.

Their type is rcl_interfaces/srv/SetParametersAtomically: a request is a list of named values, and the
response says whether all were accepted, or why not. The names are not parameters of the node.
"""

import numpy as np
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import parameter_value_to_python

from liegroup_core.fields.values import LARGEST_NUMBER, suggestion
from liegroup_core.forces.commands import PULL, WRENCH, Command
from liegroup_core.joints.coupling import COUPLED
from liegroup_core.lie.groups import SO3
from liegroup_sim_ros.messages.commands import joint_labels
from liegroup_sim_ros.messages.links import merged_links
from liegroup_sim_ros.serving.counted_input import MOST, bounded

from .standard_codes import FAILED, Refused

BOUND = f"; the largest magnitude is {LARGEST_NUMBER:g}"
LONGEST = 1e9  # s, duration of a wrench
NOT_UNIT = 1e-3  # largest difference of a quaternion's norm from 1
OF_JOINTS = ("position", "velocity")
SOURCE = "service"
LONGEST_SHOWN = 60  # characters of a wrong value in an error text


def Wrong(text):
    """Refused with one line of text."""
    return Refused(FAILED, text)


def offer(node):
    """Create the services of a SimNode."""
    for name, serve in (("set_state", set_state), ("apply_wrench", apply_wrench), ("apply_pull", apply_pull)):
        node.create_service(
            SetParametersAtomically, f"~/{name}", lambda request, _, serve=serve: serve(node, _values(request))
        )


async def set_state(node, values):
    """Set BODY/pose (x y z qx qy qz qw, world axes), BODY/twist (angular, linear, body axes),
    JOINT/position and JOINT/velocity (rad and rad/s, or m and m/s).
    """
    poses, twists, joints = {}, {}, {}
    for name, value in values.items():
        owner, _, kind = name.rpartition("/")
        if kind in OF_JOINTS:
            if type(value) not in (int, float) or not bounded([value]):
                raise Wrong(f"{name:.60} must be a finite number, got {_shown(value)}{BOUND}")
            joints.setdefault(_joint(node, owner), [None, None])[OF_JOINTS.index(kind)] = value
            continue
        if kind not in ("pose", "twist"):
            raise Wrong(f"unknown name {name!r:.60}: give BODY/pose, BODY/twist, JOINT/position or JOINT/velocity")
        body = _body(node, owner)
        if kind == "pose":
            numbers = _vector(name, value, 7)
            norm = np.linalg.norm(numbers[3:])
            if not abs(norm - 1.0) <= NOT_UNIT:
                raise Wrong(f"{name}: its quaternion has norm {norm:g}, not 1")
            poses[body] = np.eye(4)
            poses[body][:3, 3] = numbers[:3]
            poses[body][:3, :3] = SO3.from_quaternion(numbers[3:] / norm)
        else:
            twists[body] = _vector(name, value, 6)
    return await node.ask("place", poses, twists, joints, " and ".join(values))


def apply_wrench(node, values):
    """Apply force and torque at a point of a body for a duration, from the next step on."""
    known = {"body", "force", "torque", "point", "axes", "duration", "name"}
    for name in values.keys() - known:
        raise Wrong(f"unknown name {name!r:.60}: choose from {', '.join(sorted(known))}")
    axes = values.get("axes", "body")
    body, place = _body_or_link(node, values.get("body", ""))
    if axes not in ("body", "world"):
        raise Wrong(f"axes must be 'body' or 'world', got {_shown(axes)}")
    force, torque, point = (_vector(name, values.get(name, [0.0] * 3), 3) for name in ("force", "torque", "point"))
    point = place[:3, :3] @ point + place[:3, 3]
    if axes == "body":
        force, torque = place[:3, :3] @ force, place[:3, :3] @ torque
    _vector("point times force", np.outer(point, force).ravel(), 9)
    duration, name = _duration_and_name(values)
    server = node.scene_run.server
    if server.inputs_held >= MOST:
        raise Wrong(f"{MOST} wrenches already act or are scheduled")
    wrench = (*torque.tolist(), *force.tolist())
    command = Command(WRENCH, body, wrench, None, None, f"{SOURCE}/{body}/{name}", axes, tuple(point.tolist()))
    server.push([command], duration)
    return f"wrench on {body} for {duration:g} s, from the next step after {server.stamp_ns * 1e-9:.9g} s"


def apply_pull(node, values):
    """Pull at a point of a body with a spring and a damper to a point in the world, from the next step on."""
    numbers = ("stiffness", "damping", "turning_damping")
    known = {"body", "to", "point", "torque", *numbers, "duration", "name"}
    for name in values.keys() - known:
        raise Wrong(f"unknown name {name!r:.60}: choose from {', '.join(sorted(known))}")
    body, place = _body_or_link(node, values.get("body", ""))
    to, point, torque = (_vector(name, values.get(name, [0.0] * 3), 3) for name in ("to", "point", "torque"))
    for name in numbers:
        value = values.get(name, 0.0)
        if type(value) not in (int, float) or not bounded([value]) or value < 0.0:
            raise Wrong(f"{name} must be a finite number that is not negative, got {_shown(value)}{BOUND}")
    k, c, turning = (float(values.get(name, 0.0)) for name in numbers)
    point = place[:3, :3] @ point + place[:3, 3]
    duration, name = _duration_and_name(values)
    given = (k, c, *to.tolist(), *torque.tolist(), turning)
    given = given if any((k, c, *torque, turning)) else (0.0,) * len(given)
    source = f"{SOURCE}/{body}/{name}"
    node.scene_run.server.push([Command(PULL, body, given, None, None, source, point=tuple(point.tolist()))], duration)
    return f"pull on {body} for {duration:g} s, from the next step after {node.scene_run.server.stamp_ns * 1e-9:.9g} s"


def _duration_and_name(values):
    duration, name = values.get("duration"), values.get("name", "")
    if type(duration) not in (int, float) or not 1e-9 <= duration <= LONGEST:
        raise Wrong(f"duration must be a number of seconds from 1e-9 to {LONGEST:g}, got {_shown(duration)}")
    if not isinstance(name, str):
        raise Wrong(f"name must be a text, got {_shown(name)}")
    return float(duration), name


def _values(request):
    values = {p.name: parameter_value_to_python(p.value) for p in request.parameters}
    if len(values) < len(request.parameters):
        raise Wrong("a name occurs twice")
    if not values:
        raise Wrong("no values are given")
    return values


def _body(node, name):
    """Name of a body in the scene, from its own name or the name of its link in a robot."""
    return _known(node, name, {})


def _known(node, name, others):
    """What a name stands for: a body, by its own name or its link's, or one of `others`."""
    scene = node.scene_run.simulation.scene
    bodies = {body.name: body.name for body in scene.bodies}
    links = {} if scene.robot is None else {link: body for body, link in scene.robot.links.items()}
    known = bodies | links | others | bodies  # bodies are listed first, and win
    if not isinstance(name, str) or name not in known:
        raise Wrong(f"unknown body {_shown(name)}; {suggestion(_shown(name), list(known))}")
    return known[name]


def _body_or_link(node, name):
    """(body, (4, 4) pose in the body frame) of a body, or of a link that is merged into it."""
    found = _known(node, name, merged_links(node.scene_run.simulation.scene))
    return (found, np.eye(4)) if isinstance(found, str) else found


def _joint(node, name):
    """Name in the scene of a joint with one coordinate, from its name in messages."""
    scene = node.scene_run.simulation.scene
    joints = [joint.name for joint in scene.joints if joint.type in COUPLED]
    known = dict(zip(joint_labels(joints, scene.robot), joints))
    if name not in known:
        hint = suggestion(_shown(name), list(known)) if known else "the scene has none"
        raise Wrong(f"{_shown(name)} is not a joint with one coordinate; {hint}")
    return known[name]


def _vector(name, value, size):
    """(size,) numbers."""
    try:
        numbers = np.array(value, dtype=float)
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    if isinstance(value, str) or numbers.shape != (size,) or not bounded(numbers):
        raise Wrong(f"{name:.60} must be {size} finite numbers, got {_shown(value)}{BOUND}")
    return numbers


def _shown(value):
    text = repr(list(value) if hasattr(value, "tolist") else value)
    return text if len(text) <= LONGEST_SHOWN else f"{text[:LONGEST_SHOWN]}..."
