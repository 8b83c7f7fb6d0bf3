# SPDX-License-Identifier: Apache-2.0
"""Parameters of the simulation node: one table that declares, checks and documents them.

A wrong value, a wrong type or an unknown name raises NodeParameterError: one line with the parameter,
what is wrong and what to do. An integer is accepted for a floating-point parameter.
"""

import difflib
import logging
import re
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from types import SimpleNamespace

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.parameter import Parameter

from liegroup_core.fields.values import suggestion
from liegroup_core.methods.table import METHODS
from liegroup_core.settings import SETTINGS, Setting
from liegroup_core.simulation import default_steps
from liegroup_sim_ros.messages.samples import OPTIONAL, TF_LINKS
from liegroup_sim_ros.messages.topics import MOST_OWN, own_by_default
from liegroup_sim_ros.serving import lockstep
from liegroup_sim_ros.serving.joint_command_input import INTERFACES
from liegroup_sim_ros.serving.outputs import NodeParameterError

QOS_PREFIX = "qos_overrides."
_QOS = {
    "reliability": Setting("reliability", "reliable", "", choices=("reliable", "best_effort")),
    "depth": Setting("depth", 1, "", "messages", 1, 1_000_000),
}
LONGEST_SHOWN = 60  # characters of a wrong value in an error text
HOLDS = ("one_step", "timeout", "until_replaced")
ACCURACY = ("accuracy", "accuracy_horizon")  # not used with a method
# Parameters whose values are in the recording continue_from.
CONTINUED = ("scene", "method", *ACCURACY, "stabilisation", "group", "step")
LEAST = 1e-9  # of numbers that are not 0: the resolution of time stamps in s, and no overflow where they divide
AUTO = "auto"  # a method or stabilisation that an accuracy chooses


@dataclass(frozen=True)
class Entry(Setting):
    """One parameter. Its type is that of its default."""

    least: float = LEAST
    settable: bool = False  # True: may be set while the node runs
    is_topic_rate: bool = False  # True: messages are sent at whole steps, see Values.steps
    package: str = ""  # without this package the default is 0

    @property
    def usual(self):
        """Default on this machine."""
        return self.default if not self.package or find_spec(self.package) else 0.0

    @property
    def meaning(self):
        """As of a Setting, with what the default means."""
        return super().meaning + (f"; {self.shown_default}: {self.means}" if self.means else "")


def _setting(of_run, more="", **changes):
    """Entry of a setting of a run; more: of its text."""
    setting = vars(SETTINGS[of_run])
    return Entry(**setting | {"text": setting["text"] + more, "least": LEAST} | changes)


_live = partial(Entry, settable=True)


def _rate(name, default, topics, remark="", package=""):
    text = f"rate of {topics} in Hz of simulated time; 0: not published{remark}"
    return _live(name, default, text, "", 0.0, 1e5, is_topic_rate=True, package=package)


# Rate of topics for viewers in Hz, as robot_state_publisher has by default: nearly smooth, and a divisor of 100 Hz, so
# that it requires no other step.
VIEWED = 20.0
TABLE = (
    _live(
        "scene",
        "",
        "path of a scene file (YAML) or of a robot (URDF, xacro, SDF, MJCF; also package:// and "
        "model://), or name of an example scene; ~/reload loads a new value",
    ),
    Entry(
        "world_folders",
        "",
        "folders, separated by colons, from which (with subfolders) requests may load scenes and robots, in "
        "addition to the tree of scene, the example scenes and the search paths of ROS and Gazebo; /: any file",
    ),
    _setting(
        "accuracy", ". If real time requires it, the node makes the accuracy coarser and sends an event", settable=True
    ),
    _setting("horizon", name="accuracy_horizon"),
    _setting("method", default=AUTO, choices=(AUTO, *METHODS)),
    _setting("stabilisation", default=AUTO, choices=(AUTO, *SETTINGS["stabilisation"].choices)),
    _setting("group"),
    _setting(
        "step", default=0.0, low=0.0, high=10.0, means=SETTINGS["step"].means + ", and the shortest period of a rate"
    ),
    _setting(
        "estimate",
        ". The estimate is in ~/state, /diagnostics, ~/errors and the covariances of ~/BODY/odometry and "
        "~/BODY/pose_with_covariance",
    ),
    _live("real_time_factor", 1.0, "simulated seconds per second; 0: as fast as possible", "", 0.0, 1e6),
    Entry("start_paused", False, "start paused, until ~/resume or ~/step is called"),
    _live(
        "lockstep",
        "",
        "inputs that must answer every state, with its time stamp, before the simulation goes on, and their rates in "
        "Hz: joint_commands@1000, wrench/left@100; the periods are multiples of the step. Without values of their own "
        "publish_rate, joint_state_rate and clock_rate have the highest of these rates",
        means="none",
    ),
    _live(
        "lockstep_timeout",
        5.0,
        "wall time after which a missing answer pauses the simulation, once its controller has answered; 0: never",
        "s",
        0.0,
        1e6,
    ),
    _live("step_count", 1, "number of steps per call of ~/step", "", 1, 1000000),
    Entry("continue_from", "", "recording (*.mcap) to continue, with its scene, method and step", means="none"),
    Entry("continue_at", 0.0, "time stamp in the recording continue_from at which to continue", "s", 0.0, 1e9),
    Entry(
        "continue_inputs",
        False,
        "apply the wrenches and commands recorded after continue_at; false: all wrenches end there, "
        "and driven joints that were commanded come to rest",
    ),
    _live("snapshot", "snapshot", "name of the snapshot that ~/save_snapshot saves and ~/restore_snapshot restores"),
    Entry(
        "record", "", "recording file (*.mcap; missing folders are created), or existing folder", means="no recording"
    ),
    Entry(
        "record_rate",
        0.0,
        "rate of poses, twists and ~/errors in the recording in Hz of simulated time",
        low=0.0,
        high=1e5,
        means="publish_rate",
        is_topic_rate=True,
    ),
    Entry(
        "record_flush_interval",
        1.0,
        "longest wall time in s that messages wait in memory before they are written; a killed process loses at most "
        "this",
        low=0.01,
        high=3600.0,
    ),
    Entry(
        "record_split_size", 0, "size after which a new, self-contained file begins", "bytes", 0, 10**15, means="never"
    ),
    Entry("record_split_duration", 0.0, "simulated time after which a new file begins", "s", 0.0, 1e9, means="never"),
    Entry("record_metadata", False, "write a metadata.yaml that makes the folder a rosbag2 bag"),
    Entry(
        "machine",
        "",
        "topics of a real machine to compare the scene with, such as /joint_states, separated by commas, or a map "
        "(*.yaml) as for `liegroup_sim compare`",
        means="none",
    ),
    _live("machine_tolerance", 0.05, "error of a prediction of the machine that still serves", "rad and m", LEAST, 1e6),
    _live(
        "machine_ahead",
        1.0,
        "event `machine`: an output is predicted this far ahead, or less, with a larger error than machine_tolerance "
        "and than noise explains",
        "s",
        0.1,
        3.0,
    ),
    Entry("view", False, "open a page in the browser that shows this node, see `liegroup_sim view`"),
    Entry("world_frame", "world", "frame id of the poses"),
    Entry("frame_prefix", "", "prefix of the frame ids of all bodies, such as robot1/; world_frame has no prefix"),
    _rate("publish_rate", 100.0, "poses, twists and ~/errors", "; recordings require it or record_rate"),
    _live(
        "body_topics",
        AUTO,
        "bodies with topics of their own, such as ~/BODY/pose, ~/BODY/twist and ~/BODY/wrench: all, none, or names "
        f"separated by commas or spaces; auto: all if the scene has at most {MOST_OWN} bodies, else none. Unless all "
        "have, ~/poses and ~/twists have all bodies. ~/reload uses a new value",
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
    _live("arrow_scale", 0.01, "length of the arrows in ~/markers", "m per N and per N m", 0.0, 1e6),
    _live(
        "wrench_hold",
        "timeout",
        "how long a wrench from a topic acts: one step, wrench_timeout, or until the next one of its source",
        choices=HOLDS,
    ),
    _live("wrench_timeout", 0.1, "simulated duration of a wrench if wrench_hold is timeout", "s", LEAST, 1e6),
    _live(
        "command_timeout",
        0.0,
        "simulated duration of a command from ~/joint_commands or ~/commands",
        "s",
        0.0,
        1e6,
        means="until the next one of its joint",
    ),
    _live(
        "command_stamps",
        True,
        "commands for joints start at their time stamp if that is in the future; false: stamps are "
        "ignored, for publishers with another clock",
    ),
    _live(
        "command_jump",
        0.0,
        "largest distance of a commanded position from the present position of the servo or driven joint, "
        "rad or m; of a trajectory: largest change within trajectory_period. Larger ones are "
        "refused; 0: only positions beyond the limits of the joint are refused",
        low=0.0,
        high=1e6,
    ),
    Entry("command_joints", "", "joints of ~/commands in the order of its numbers, with commas", means="no such topic"),
    Entry("command_interface", "position", "quantity that ~/commands contains", choices=INTERFACES),
    Entry("trajectory_period", 0.002, "simulated time for which targets of trajectories are constant", "s", 1e-5, 1.0),
    Entry("motion_time", 0.02, "simulated time in which a driven joint reaches a command", "s", 1e-5, 1e3),
)
_ENTRIES = {entry.name: entry for entry in TABLE}
FOLLOWING = ("publish_rate", "joint_state_rate", "clock_rate")  # at least the rates of the lockstep, by default
RATES = tuple(entry.name for entry in TABLE if entry.is_topic_rate)
log = logging.getLogger("liegroup_core")
# Declared by rclpy itself. This node publishes simulated time, so it cannot subscribe to it: use_sim_time
# from a launch file is ignored at start, and a later change is refused.
_BUILT_IN = ("use_sim_time", "start_type_description_service")


def check(name, value, setting=None):
    """Convert a value to its parameter's type. Raises NodeParameterError."""
    try:
        return (setting or _ENTRIES[name]).check(value, f"parameter {name}: ")
    except ValueError as error:
        raise NodeParameterError(str(error)) from None


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
    fastest = max(answering(check("lockstep", overrides.get("lockstep", ""))).values(), default=0.0)
    for entry in TABLE:
        usual = max(entry.usual, fastest) if entry.name in FOLLOWING else entry.usual
        value = check(entry.name, overrides.get(entry.name, usual))
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
        values.step = values.step or _dividing(values, SETTINGS["step"].default)
    elif not (values.estimate or values.continue_from):
        raise NodeParameterError("parameter estimate: must be true with an accuracy; or choose a method")
    values.rates = {name: getattr(values, name) for name in RATES}
    values.qos = [name for name in overrides if name.startswith(QOS_PREFIX)]
    for name in values.qos:
        if policy := _QOS.get(name.rpartition(".")[2]):
            check(name, overrides[name], policy)  # clearer than the text of rclpy
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
    longest = next(step for step in default_steps(values.accuracy_horizon) if step * most <= 1.0 + 1e-9)
    return _dividing(values, longest)


def _dividing(values, longest):
    """Step in s, at most `longest`, that divides the periods of the lockstep."""
    rates = answering(values.lockstep).values()
    return lockstep.fitting_step(rates, longest) if rates else longest


def answering(text):
    """{topic: rate in Hz} of the parameter lockstep. Raises NodeParameterError."""
    found = {}
    for part in text.replace(",", " ").split():
        topic, _, rate = part.removeprefix("~/").partition("@")
        try:
            hz = float(rate)
        except ValueError:
            hz = 0.0
        if not re.fullmatch(r"[A-Za-z]\w*(/[A-Za-z]\w*)*", topic) or topic in found or not 1e-3 <= hz <= 1e5:
            raise NodeParameterError(
                f"parameter lockstep: must have each topic once, as TOPIC@RATE with a rate from 0.001 to 1e5 Hz, got "
                f"{part!r:.{LONGEST_SHOWN}}"
            )
        found[topic] = hz
    return found


def watch_parameters(node, prepare, changed):
    """Check parameters that are set while the node runs, call prepare(name, value), then changed(name, value).

    prepare raises NodeParameterError if the node cannot take a value; `changed` follows when it has taken all.
    """

    def convert(parameters):
        return [
            Parameter(p.name, value=float(p.value))
            if p.name in _ENTRIES and _ENTRIES[p.name].kind is float and type(p.value) is int
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


def _descriptor(entry):
    descriptor = ParameterDescriptor(
        description=entry.meaning, read_only=not entry.settable, additional_constraints=entry.allowed
    )
    if entry.kind is int:
        descriptor.integer_range = [IntegerRange(from_value=entry.low, to_value=entry.high)]
    elif entry.kind is float:
        descriptor.floating_point_range = [FloatingPointRange(from_value=entry.low, to_value=entry.high)]
    return descriptor
