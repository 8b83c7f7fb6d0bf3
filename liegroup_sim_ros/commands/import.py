# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim import`: convert a robot file to a scene file that can be edited. No ROS."""

import sys
from pathlib import Path

from liegroup_core.describe import imported
from liegroup_core.layout import make_layout
from liegroup_sim_ros.numbers import counted
from liegroup_sim_ros.report.files import write_text

from .robot_options import RobotError, add_robot_options, robot_scene


def add_arguments(parser):
    """Arguments of the subcommand."""
    parser.description = (
        "Write the scene file of a robot: bodies, joints and forces, each with the line of the robot file "
        "that it comes from as a comment, and notes on merged and omitted parts. Every command also "
        "takes the robot file itself."
    )
    parser.add_argument(
        "robot",
        metavar="FILE",
        help="URDF, xacro, SDF or MJCF file, or a scene file with the key robot; paths may begin "
        "with package:// or model://",
    )
    parser.add_argument("--out", metavar="FILE", help="scene file; it must not exist (default: standard output)")
    parser.add_argument("--name", metavar="NAME", help="name of the scene")
    add_robot_options(parser)


def run(args):
    """Run the subcommand; returns the exit code. Raises SceneError."""
    if args.out is not None and Path(args.out).exists():
        raise RobotError(f"{args.out} exists: choose another name for --out")
    if args.out is not None and Path(args.out).suffix not in (".yaml", ".yml"):
        raise RobotError(f"--out {args.out}: a scene file ends in .yaml")
    scene = robot_scene(args.robot, args, args.name)
    counts = imported(make_layout(scene))  # raises SceneError if the scene cannot be simulated
    text = scene.text
    if counts is not None:
        text = (
            f"# {counted(counts['links'], 'link')} of the file -> "
            f"{counted(counts['bodies'], 'body')}, "
            f"{counted(counts['file_coordinates'], 'joint coordinate')} -> "
            f"{counts['coordinates']}\n{text}"
        )
    if args.out is None:
        print(text, end="")
        return 0
    write_text(args.out, text)
    bodies, joints = counted(len(scene.bodies), "body"), counted(len(scene.joints), "joint")
    print(f"{args.out}: {bodies}, {joints}", file=sys.stderr)
    for note in scene.notes:
        print(f"  {note}", file=sys.stderr)
    return 0
