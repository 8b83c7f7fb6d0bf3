# SPDX-License-Identifier: Apache-2.0
"""Parameters of the simulation node: one table that declares, checks and documents them.

A wrong value, a wrong type or an unknown name raises NodeParameterError: one line with the parameter,
what is wrong and what to do. An integer is accepted for a floating-point parameter.
"""

import difflib
import logging
import math
from importlib.util import find_spec
from types import SimpleNamespace
from typing import NamedTuple

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.parameter import Parameter

from liegroup_core.accuracy import DEFAULT, LONGEST, MINUTE, SMALLEST
from liegroup_core.engine import STABILISATIONS, STEP
from liegroup_core.fields.values import suggestion
from liegroup_core.methods.table import CONFIGURATION_GROUPS, METHODS
from liegroup_core.simulation import default_steps
from liegroup_sim_ros.messages.samples import OPTIONAL, TF_LINKS
from liegroup_sim_ros.messages.topics import MOST_OWN, own_by_default
from liegroup_sim_ros.serving.joint_command_input import INTERFACES
from liegroup_sim_ros.serving.outputs import NodeParameterError

QOS_PREFIX = "qos_overrides."
RELIABILITIES = ("reliable", "best_effort")
DEEPEST = 1_000_000  # largest QoS depth, messages
LONGEST_SHOWN = 60  # characters of a wrong value in an error text
HOLDS = ("one_step", "timeout", "until_replaced")
ACCURACY = ("accuracy", "accuracy_horizon")  # not used with a method
# Parameters whose values are in the recording continue_from.
CONTINUED = ("scene", "method", *ACCURACY, "stabilisation", "group", "step")
LEAST = 1e-9  # of numbers that are not 0: the resolution of time stamps in s, and no overflow where they divide
AUTO = "auto"  # a method or stabilisation that an accuracy chooses


class Entry(NamedTuple):
    """One parameter. Its type is that of its default."""

    name: str
    default: object
    text: str
    read_only: bool = True  # False: may be set while the node runs
    choices: tuple = ()
    low: float | None = None
    high: float | None = None
    is_topic_rate: bool = False  # True: messages are sent at whole steps, see Values.steps
    package: str = ""  # without this package the default is 0

    @property
    def usual(self):
        """Default on this machine."""
        return self.default if not self.package or find_spec(self.package) else 0.0


def _rate(name, default, topics, remark="", package=""):
    return Entry(
        name,
        default,
        f"rate of {topics} in Hz of simulated time; 0: not published{remark}",
        read_only=False,
        low=0.0,
        high=1e5,
        is_topic_rate=True,
        package=package,
    )


# Rate of topics for viewers in Hz, as robot_state_publisher has by default: nearly smooth, and a divisor of 100 Hz, so
# that it requires no other step.
VIEWED = 20.0
TABLE = (
    Entry(
        "scene",
        "",
        "path of a scene file (YAML) or of a robot (URDF, xacro, SDF, MJCF; also package:// and "
        "model://), or name of an example scene; ~/reload loads a new value",
        read_only=False,
    ),
    Entry(
        "world_folders",
        "",
        "folders, separated by colons, from which (with subfolders) requests may load scenes and robots, in "
        "addition to the tree of scene, the example scenes and the search paths of ROS and Gazebo; /: any file",
    ),
    Entry(
        "accuracy",
        DEFAULT,
        "largest error in the first accuracy_horizon seconds: of positions relative to the mechanism's "
        "size, of attitudes in rad. It may grow by as much in each further horizon. If real time "
        "requires it, the node makes the accuracy coarser and sends an event",
        read_only=False,
        low=SMALLEST,
        high=1.0,
    ),
    Entry(
        "accuracy_horizon",
        MINUTE,
        "simulated time in which the error may grow by the accuracy, s",
        low=LEAST,
        high=LONGEST,
    ),
    Entry(
        "method",
        AUTO,
        "integration method; auto: method and step sizes that keep the accuracy",
        choices=(AUTO, *METHODS),
    ),
    Entry(
        "stabilisation",
        AUTO,
        "correction of constraint drift; auto: projection if an accuracy is set and joints would drift, else none",
        choices=(AUTO, *STABILISATIONS),
    ),
    Entry(
        "group",
        "auto",
        "configuration space: SE(3) or SO(3) x R^3 for every body, or relative, the product of the "
        "joints' motion groups; auto: relative, for rotation methods SO(3) x R^3",
        choices=("auto", *CONFIGURATION_GROUPS),
    ),
    Entry(
        "step",
        0.0,
        f"step size of the method, s; 0: {STEP:g}. With an accuracy: interval of checks and of single steps; "
        "0: at most 0.01, a fiftieth of accuracy_horizon and the shortest period of a rate",
        low=0.0,
        high=10.0,
    ),
    Entry(
        "estimate",
        True,
        "estimate the global error, at about 1.8 times the cost. The estimate is in ~/state, "
        "/diagnostics, ~/errors and the covariances of ~/BODY/odometry and "
        "~/BODY/pose_with_covariance",
    ),
    Entry(
        "real_time_factor",
        1.0,
        "simulated seconds per second; 0: as fast as possible",
        read_only=False,
        low=0.0,
        high=1e6,
    ),
    Entry("start_paused", False, "start paused, until ~/resume or ~/step is called"),
    Entry("step_count", 1, "number of steps per call of ~/step", read_only=False, low=1, high=1000000),
    Entry(
        "continue_from",
        "",
        "recording (*.mcap) to continue with its scene, method and step, instead of scene; empty: none",
    ),
    Entry("continue_at", 0.0, "time stamp in the recording continue_from at which to continue, s", low=0.0, high=1e9),
    Entry(
        "continue_inputs",
        False,
        "apply the wrenches and commands recorded after continue_at; false: all wrenches end there, "
        "and driven joints that were commanded come to rest",
    ),
    Entry(
        "snapshot",
        "snapshot",
        "name of the snapshot that ~/save_snapshot saves and ~/restore_snapshot restores",
        read_only=False,
    ),
    Entry(
        "record", "", "recording file (*.mcap; missing folders are created), or existing folder; empty: no recording"
    ),
    Entry(
        "record_rate",
        0.0,
        "rate of poses, twists and ~/errors in the recording in Hz of simulated time; 0: publish_rate",
        low=0.0,
        high=1e5,
        is_topic_rate=True,
    ),
    Entry(
        "record_flush_interval",
        1.0,
        "longest wall time that messages wait in memory before they are written, s; a "
        "killed process loses at most this",
        low=0.01,
        high=3600.0,
    ),
    Entry(
        "record_split_size",
        0,
        "size in bytes after which the recording continues in a new, self-contained file; 0: never",
        low=0,
        high=10**15,
    ),
    Entry(
        "record_split_duration",
        0.0,
        "simulated time after which the recording continues in a new file, s; 0: never",
        low=0.0,
        high=1e9,
    ),
    Entry("record_metadata", False, "write a metadata.yaml that makes the folder a rosbag2 bag"),
    Entry("view", False, "open a page in the browser that shows this node, see `liegroup_sim view`"),
    Entry("world_frame", "world", "frame id of the poses"),
    Entry("frame_prefix", "", "prefix of the frame ids of all bodies, such as robot1/; world_frame has no prefix"),
    _rate("publish_rate", 100.0, "poses, twists and ~/errors", "; recordings require it or record_rate"),
    Entry(
        "body_topics",
        AUTO,
        "bodies with topics of their own, such as ~/BODY/pose, ~/BODY/twist and ~/BODY/wrench: all, none, or names "
        f"separated by commas or spaces; auto: all if the scene has at most {MOST_OWN} bodies, else none. Unless all "
        "have, ~/poses and ~/twists have all bodies. ~/reload uses a new value",
        read_only=False,
    ),
    _rate("clock_rate", 100.0, "/clock"),
    _rate("state_rate", 10.0, "~/state"),
    _rate("joint_state_rate", VIEWED, "~/joint_states"),
    _rate("tf_rate", VIEWED, "/tf", "; by default only if tf2_msgs is installed", "tf2_msgs"),
    _rate("marker_rate", VIEWED, "~/markers"),
    *(_rate(name, 0.0, topic) for name, (_, topic) in OPTIONAL.items() if name not in ("joint_state_rate", "tf_rate")),
    Entry(
        "tf_links",
        TF_LINKS[0],
        "links in /tf; roots: only links without a parent joint, for use with a "
        "robot_state_publisher that publishes the others",
        choices=TF_LINKS,
    ),
    Entry(
        "arrow_scale",
        0.01,
        "length of the arrows in ~/markers, m per N and per N m",
        read_only=False,
        low=0.0,
        high=1e6,
    ),
    Entry(
        "wrench_hold",
        "timeout",
        "how long a wrench from ~/wrench or ~/BODY/wrench acts: one step, "
        "wrench_timeout, or until the next one of its source",
        read_only=False,
        choices=HOLDS,
    ),
    Entry(
        "wrench_timeout",
        0.1,
        "duration of a wrench if wrench_hold is timeout, s of simulated time",
        read_only=False,
        low=LEAST,
        high=1e6,
    ),
    Entry(
        "command_timeout",
        0.0,
        "duration of a command from ~/joint_commands or ~/commands, s of simulated time; 0: until the "
        "next one of its joint",
        read_only=False,
        low=0.0,
        high=1e6,
    ),
    Entry(
        "command_stamps",
        True,
        "commands for joints start at their time stamp if that is in the future; false: stamps are "
        "ignored, for publishers with another clock",
        read_only=False,
    ),
    Entry(
        "command_jump",
        0.0,
        "largest distance of a commanded position from the present position of the servo or driven joint, "
        "rad or m; of a trajectory: largest change within trajectory_period. Larger ones are "
        "refused; 0: only positions beyond the limits of the joint are refused",
        read_only=False,
        low=0.0,
        high=1e6,
    ),
    Entry(
        "command_joints",
        "",
        "joints of ~/commands, separated by commas, in the order of its numbers; empty: no such topic",
    ),
    Entry("command_interface", "position", "quantity that ~/commands contains", choices=INTERFACES),
    Entry(
        "trajectory_period",
        0.002,
        "time during which the targets of a trajectory for the servos are constant, s of simulated time",
        low=1e-5,
        high=1.0,
    ),
    Entry(
        "motion_time",
        0.02,
        "time in which a driven joint reaches a commanded position or velocity, s of simulated time",
        low=1e-5,
        high=1e3,
    ),
)
_ENTRIES = {entry.name: entry for entry in TABLE}
RATES = tuple(entry.name for entry in TABLE if entry.is_topic_rate)
log = logging.getLogger("liegroup_core")
_TYPE_NAMES = {str: "a text", bool: "true or false", int: "a whole number", float: "a number"}
# Declared by rclpy itself. This node publishes simulated time, so it cannot subscribe to it: use_sim_time
# from a launch file is ignored at start, and a later change is refused.
_BUILT_IN = ("use_sim_time", "start_type_description_service")


def check(name, value):
    """Convert a value to its parameter's type. Raises NodeParameterError."""
    entry = _ENTRIES[name]
    expected = type(entry.default)
    if expected is float and type(value) is int:
        value = float(value)
    if type(value) is not expected:
        raise NodeParameterError(f"parameter {name}: must be {_TYPE_NAMES[expected]}, got {_shown(value)}")
    if entry.choices and value not in entry.choices:
        raise NodeParameterError(f"parameter {name}: must be {_listed(entry.choices)}, got {_shown(value)}")
    if expected is float and not math.isfinite(value):
        raise NodeParameterError(f"parameter {name}: must be finite, got {_shown(value)}")
    is_tiny = expected is float and entry.low == 0.0 < value < LEAST
    if entry.low is not None and (not entry.low <= value <= entry.high or is_tiny):
        raise NodeParameterError(f"parameter {name}: must be {_range(entry)}, got {_shown(value)}")
    return value


def read_parameters(node):
    """Declare all parameters of `node` and return their values, one attribute per parameter.

    node : created with automatically_declare_parameters_from_overrides=True, so that unknown names,
           which ROS ignores, can be refused
    returns the values; `.rates`: {name: rate in Hz of simulated time, 0 for none}; `.qos`: names of the parameters
            for quality of service, which qos.py reads
    raises NodeParameterError
    """
    overrides = {
        name: parameter.value for name, parameter in node.get_parameters_by_prefix("").items() if name not in _BUILT_IN
    }
    for name in overrides:
        node.undeclare_parameter(name)  # declared again below, with its descriptor
        if name not in _ENTRIES and not name.startswith(QOS_PREFIX):
            near = difflib.get_close_matches(name, _ENTRIES, n=1)
            hint = f"did you mean {near[0]}?" if near else f"choose one of: {', '.join(_ENTRIES)}"
            raise NodeParameterError(f"parameter {name}: unknown; {hint}")
    values = SimpleNamespace()
    for entry in TABLE:
        value = check(entry.name, overrides.get(entry.name, entry.usual))
        node.declare_parameter(entry.name, value, _descriptor(entry), ignore_override=True)
        setattr(values, entry.name, value)
    if values.continue_from:
        for name in CONTINUED:
            if getattr(values, name) != _ENTRIES[name].default:
                raise NodeParameterError(
                    f"parameter {name}: cannot be combined with continue_from, whose recording has "
                    "its own; remove one of them"
                )
    if values.method != AUTO:
        for name in ACCURACY:  # defaults are accepted: a dump of all parameters contains them
            if getattr(values, name) != _ENTRIES[name].default:
                raise NodeParameterError(f"parameter {name}: cannot be combined with method; remove one of them")
        values.step = values.step or STEP
    elif not (values.estimate or values.continue_from):
        raise NodeParameterError("parameter estimate: must be true with an accuracy; or choose a method")
    values.rates = {name: getattr(values, name) for name in RATES}
    values.qos = [name for name in overrides if name.startswith(QOS_PREFIX)]
    for name in values.qos:
        _check_qos(name, overrides[name])
    if values.record and not (values.publish_rate or values.record_rate):
        raise NodeParameterError(
            "parameter publish_rate: must be greater than 0 to record, because a recording consists of poses and "
            "twists; or set record_rate"
        )
    return values


def bodies_of(text, bodies):
    """Those of the bodies to which the parameter body_topics gives topics of their own. Raises NodeParameterError."""
    if text in (AUTO, "all", "none"):
        return {AUTO: own_by_default(bodies), "all": bodies, "none": ()}[text]
    names = text.replace(",", " ").split()
    for name in names:
        if name not in bodies:
            hint = suggestion(name, [AUTO, "all", "none", *bodies])
            raise NodeParameterError(f"parameter body_topics: the scene has no body {name!r:.{LONGEST_SHOWN}}; {hint}")
    return tuple(body for body in bodies if body in names)


def fitting_step(values):
    """Step for an accuracy, s, that is not longer than the shortest period of a rate.

    A state after a command within a step takes parts of that step: it should not have many.
    """
    most = max(values.rates.values())
    return next(step for step in default_steps(values.accuracy_horizon) if step * most <= 1.0 + 1e-9)


def watch_parameters(node, prepare, changed):
    """Check parameters that are set while the node runs, call prepare(name, value), then changed(name, value).

    prepare raises NodeParameterError if the node cannot take a value; `changed` follows when it has taken all.
    """

    def convert(parameters):
        return [
            Parameter(p.name, value=float(p.value))
            if p.name in _ENTRIES and type(_ENTRIES[p.name].default) is float and type(p.value) is int
            else p
            for p in parameters
        ]

    def validate(parameters):
        try:
            for parameter in parameters:
                if parameter.name == "use_sim_time" and parameter.value is not False:
                    raise NodeParameterError(
                        "parameter use_sim_time: must be false, because this node publishes the simulated time"
                    )
                if parameter.name in _ENTRIES:
                    check(parameter.name, parameter.value)
                    prepare(parameter.name, parameter.value)
        except NodeParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def apply(parameters):
        for parameter in parameters:
            if parameter.name in _ENTRIES:
                changed(parameter.name, parameter.value)

    node.add_pre_set_parameters_callback(convert)
    node.add_on_set_parameters_callback(validate)
    node.add_post_set_parameters_callback(apply)


def allowed_values(entry):
    """Allowed values of an Entry as text."""
    return _listed(entry.choices) or (_range(entry) if entry.low is not None else _TYPE_NAMES[type(entry.default)])


def _check_qos(name, value):
    """Raise NodeParameterError for an invalid QoS value, with a clearer text than that of rclpy."""
    policy = name.rpartition(".")[2]
    if policy == "reliability" and value not in RELIABILITIES:
        raise NodeParameterError(f"parameter {name}: must be {_listed(RELIABILITIES)}, got {_shown(value)}")
    if policy == "depth" and not (type(value) is int and 1 <= value <= DEEPEST):
        raise NodeParameterError(
            f"parameter {name}: must be a whole number of at least 1 and at most {DEEPEST}, got {_shown(value)}"
        )


def _descriptor(entry):
    descriptor = ParameterDescriptor(description=entry.text, read_only=entry.read_only)
    if entry.choices:
        descriptor.additional_constraints = f"one of: {', '.join(entry.choices)}"
    elif entry.low is not None:
        descriptor.additional_constraints = _range(entry)
        if type(entry.default) is int:
            descriptor.integer_range = [IntegerRange(from_value=entry.low, to_value=entry.high)]
        else:
            descriptor.floating_point_range = [FloatingPointRange(from_value=entry.low, to_value=entry.high)]
    return descriptor


def _shown(value):
    text = repr(value)
    return text if len(text) <= LONGEST_SHOWN else f"{text[:LONGEST_SHOWN]}..."


def _range(entry):
    zero = "0, or " if entry.low == 0.0 and type(entry.default) is float else ""
    return f"{zero}at least {(zero and LEAST) or entry.low:g} and at most {entry.high:g}"


def _listed(names):
    return f"{', '.join(names[:-1])} or {names[-1]}" if names else ""
