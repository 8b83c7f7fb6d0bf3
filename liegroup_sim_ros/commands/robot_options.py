# SPDX-License-Identifier: Apache-2.0
"""Options of subcommands that take a robot file: start values, locked joints, closed loops."""

from liegroup_core.errors import LieGroupSimError, SceneError
from liegroup_core.joints.kinds import Joint
from liegroup_core.robots.ground import Ground
from liegroup_core.robots.held_joints import Servos
from liegroup_core.robots.names import scene_name
from liegroup_core.robots.options import ALL, BASES, Options
from liegroup_core.robots.starts import Start
from liegroup_core.scene.load import scene_of
from liegroup_core.scene.yaml_text import read_yaml

# Types of joints that only need the frames of two links.
CLOSING = ("spherical", "revolute", "prismatic", "cylindrical", "planar", "fixed", "universal")
# Names of the same joints in SDF and MJCF.
ALSO = {"ball": "spherical", "hinge": "revolute", "slide": "prismatic", "slider": "prismatic"}

# Of options with numbers.
WANTED = {"roll": "JOINT=RADIUS, in m", "ground": "KEY=VALUE, such as friction=0.8", "servos": "KEY=VALUE"}


class RobotError(LieGroupSimError):
    """An option is wrong or the file cannot be written; one line of text, exit code 2."""


def add_robot_options(parser):
    """Add the options; the path of the robot file is the positional argument before them."""
    parser = parser.add_argument_group("robot files (URDF, xacro, SDF, MJCF)")
    parser.add_argument("arguments", nargs="*", metavar="NAME:=VALUE", help="arguments of a xacro file")
    parser.add_argument(
        "--base",
        choices=BASES,
        help="fixed: the root link is fixed to the world (default for URDF); floating: it moves "
        "freely (default for SDF and MJCF, unless a joint holds it)",
    )
    parser.add_argument("--pose", metavar="NAME", help="pose at the start: a keyframe (MJCF) or a group state (SRDF)")
    parser.add_argument("--srdf", metavar="FILE", help="SRDF file with group states for --pose")
    for name, each, text in (
        (
            "start",
            "JOINT=VALUE",
            "joint coordinates at the start, rad or m; of a floating link, or a joint with several coordinates, "
            "as 'trunk={position: [0, 0, 1], angular_velocity: [0, 0, 2]}'",
        ),
        ("start-velocity", "JOINT=VALUE", "joint velocities at the start, rad/s or m/s"),
        ("lock", "JOINT=VALUE", "joints that do not move, at these coordinates"),
        ("only", "LINK", "keep these links and the chains that lead to them; cut the others"),
        ("keep", "JOINT", "fixed joints that are not merged, so that their reactions are known"),
        ("stops", "JOINT", "joints whose limits are stops (default: all that start within them)"),
        ("friction", "JOINT", "joints whose dry friction acts (default: all)"),
        (
            "roll",
            "JOINT=RADIUS",
            "joints whose children are wheels with this radius in m, which roll on the plane z = 0 of the world",
        ),
        ("drive", "JOINT", "driven joints; they keep their velocity at the start until a command"),
    ):
        parser.add_argument(f"--{name}", nargs="+", action="extend", default=[], metavar=each, help=text)
    parser.add_argument(
        "--ground",
        nargs="*",
        metavar="LINK | KEY=VALUE",
        help="the collision shapes of these links (default: all) touch the planes of an MJCF file, else z = 0; keys: "
        "height, friction, sinks, load, restitution (liegroup_sim keys ground)",
    )
    parser.add_argument(
        "--servos",
        nargs="+",
        metavar="JOINT | KEY=VALUE",
        help="servos hold these joints (default: all that turn and that nothing else leads) at their start, such as "
        "stiffness=300 damping=10, in N m/rad and N m s/rad, of slides N/m and N s/m",
    )
    for name, what in (
        ("stops", "limits are not stops"),
        ("friction", "no dry friction acts"),
        ("actuators", "the servos and motors of an MJCF file do not act"),
    ):
        parser.add_argument(f"--no-{name}", action="store_true", help=what)
    parser.add_argument(
        "--close",
        nargs=3,
        action="append",
        default=[],
        metavar=("LINK", "LINK", "TYPE"),
        help="close a loop by a joint of this type; its frames are those of the two links, its axis is "
        f"their z axis ({', '.join(CLOSING)})",
    )


def robot_scene(path, args, name=None):
    """Scene of a path or name with the options of `args`. Raises SceneError, RobotError.

    name : name of the scene; None: name of the robot
    """
    options = _options(args, name)
    return scene_of(path, None if options == Options() else options)


def refuse_robot_options(args):
    """Raise RobotError if options are given with a file that they cannot change."""
    if _options(args) != Options():
        raise RobotError(f"{args.scene}: a recording has its scene: it takes no options of robot files")


def _options(args, name=None):
    return Options(
        base=args.base,
        pose=args.pose,
        srdf=args.srdf,
        start=_values(args.start, "start"),
        start_velocity=_values(args.start_velocity, "start-velocity"),
        lock=_values(args.lock, "lock"),
        keep=args.keep,
        stops=[] if args.no_stops else args.stops or [ALL],
        friction=[] if args.no_friction else args.friction or [ALL],
        actuators=not args.no_actuators,
        driven=dict.fromkeys(args.drive),
        only=args.only,
        roll=_radii(args.roll),
        ground=_keyed(args.ground, "ground", Ground, "links"),
        servos=_keyed(args.servos, "servos", Servos, "joints"),
        joints=[_closing(*entry) for entry in args.close],
        name=name,
        xacro=_arguments(args.arguments),
    )


def _arguments(entries):
    """{name: text} of NAME:=VALUE texts."""
    found = {}
    for entry in entries:
        name, separator, text = entry.partition(":=")
        if not separator or not name.strip():
            raise RobotError(f"{entry:.80}: give arguments of xacro as NAME:=VALUE")
        if name.strip() in found:
            raise RobotError(f"argument {name.strip()} is given twice: keep one")
        found[name.strip()] = text.strip()
    return found


def _values(entries, option):
    """{joint: number} of JOINT=VALUE texts."""
    found = {}
    for entry in entries:
        name, separator, text = entry.rpartition("=")
        if name in found:
            raise RobotError(f"--{option} gives {name} twice: keep one")
        if option == "start" and text.startswith("{"):
            found[name] = _start(name, text)
            continue
        try:
            found[name] = float(text)
        except ValueError:
            separator = ""
        if not separator or not abs(found.get(name, 0.0)) < 1e100:
            wanted = WANTED.get(option, "JOINT=VALUE, in rad or m, rad/s or m/s")
            raise RobotError(f"--{option} {entry}: give {wanted}")
    return found


def _radii(entries):
    """{joint: radius} of JOINT=RADIUS texts."""
    found = _values(entries, "roll")
    for name, radius in found.items():
        if not radius > 0.0:
            raise RobotError(f"--roll {name}: the radius must be greater than 0, got {radius:g}")
    return found


def _keyed(entries, option, model, names):
    """Ground or Servos of names and KEY=VALUE texts; None: none.

    names : key of the names
    """
    if entries is None:
        return None
    given, numbers = [each for each in entries if "=" not in each], [each for each in entries if "=" in each]
    try:
        return model(**({names: given} | _values(numbers, option)))
    except SceneError as error:
        raise RobotError(f"--{option}: {str(error).removeprefix(f'{model.__name__}: ')}") from None


def _start(name, text):
    """Start of a text such as {position: [0, 0, 1]}."""
    try:
        return Start(**read_yaml(text, "value").value)
    except SceneError as error:
        raise RobotError(f"--start {name}: {error}") from None


def _closing(first, second, kind):
    """Joint of --close."""
    kind = ALSO.get(kind, kind)
    if kind not in CLOSING:
        raise RobotError(f"--close: type {kind!r:.40}; choose one of: {', '.join(CLOSING)}")
    return Joint(
        name=scene_name(f"close_{first}_{second}"),
        type=kind,
        parent=first,
        child=second,
        parent_frame={},
        child_frame={},
    )
