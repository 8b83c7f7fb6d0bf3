# SPDX-License-Identifier: Apache-2.0
"""Launch file: one simulation node, and on request RViz or foxglove_bridge.

ros2 launch liegroup_sim_ros sim.launch.py scene:=heavy_top record:=/tmp/run.mcap
ros2 launch liegroup_sim_ros sim.launch.py preset:=show rviz:=true

Every parameter of the node is an argument, too; an unknown argument of the command line is refused.
"""

import difflib
import sys

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription
from liegroup_sim_ros.node.parameters import TABLE

PACKAGE = "liegroup_sim_ros"

ARGUMENTS = {
    **{entry.name: ("", f"{entry.meaning}; empty: as in the preset") for entry in TABLE},
    "preset": ("default", "name of the file in config/ with the other parameters, such as show"),
    "namespace": ("", "namespace of the node"),
    "clock_topic": ("/clock", "topic of the clock; a second simulation needs another name"),
    "tf_topic": ("/tf", "topic of the transforms"),
    "rviz": ("false", "true: start RViz with config/scene.rviz; use it with preset:=show"),
    "foxglove": ("false", "true: start foxglove_bridge; the layout is config/foxglove.json"),
}
# Topics in config/scene.rviz, relative to the node.
SHOWN = ("markers", "crank/pose_with_covariance", "rod/pose_with_covariance", "slider/pose_with_covariance")


def _refuse_unknown(_):
    """Refuse unknown arguments of the command line; launch files that include this one may have others."""
    if not any(argument.endswith("sim.launch.py") for argument in sys.argv):
        return []
    known = [*ARGUMENTS, "params_file"]
    for name in (argument.partition(":=")[0] for argument in sys.argv if ":=" in argument):
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            raise RuntimeError(f"unknown argument {name!r}" + (f"; did you mean {near[0]}?" if near else "; see -s"))
    return []


def _parameter(name, kind, text):
    """Value of a parameter; a text that looks like a number stays a text."""
    try:
        value = {"true": True, "false": False}[text.lower()] if kind is bool else kind(text)
    except (KeyError, ValueError):
        raise RuntimeError(f"argument {name}: expected a value of type {kind.__name__}, got {text!r}") from None
    return ParameterValue(value, value_type=kind)


def _simulation(context):
    """The simulation node; a parameter that is not empty overrides the preset."""
    overrides = {
        entry.name: _parameter(entry.name, type(entry.default), text)
        for entry in TABLE
        if (text := LaunchConfiguration(entry.name).perform(context))
    }
    return [
        Node(
            package=PACKAGE,
            executable="sim_node",
            name="sim_node",
            output="screen",
            namespace=LaunchConfiguration("namespace"),
            remappings=[("/clock", LaunchConfiguration("clock_topic")), ("/tf", LaunchConfiguration("tf_topic"))],
            parameters=[LaunchConfiguration("params_file"), overrides]
            if overrides
            else [LaunchConfiguration("params_file")],
        )
    ]


def _viewers(context):
    """RViz and foxglove_bridge if requested. The node starts even if they are not installed."""
    # launch joins a list of substitutions to one text.
    viewers = {
        "rviz2": (
            LaunchConfiguration("rviz"),
            {
                "arguments": ["-d", [FindPackageShare(PACKAGE), "/config/scene.rviz"]],
                "remappings": [
                    (f"/sim_node/{topic}", [LaunchConfiguration("namespace"), f"/sim_node/{topic}"]) for topic in SHOWN
                ],
            },
        ),
        "foxglove_bridge": (LaunchConfiguration("foxglove"), {}),
    }
    actions = []
    for package, (argument, settings) in viewers.items():
        if argument.perform(context).lower() not in ("true", "1"):
            continue
        try:
            get_package_prefix(package)
        except PackageNotFoundError:
            apt = f"ros-jazzy-{package.replace('_', '-')}"
            actions.append(LogInfo(msg=f"{package} is not installed, starting without it: {apt}"))
        else:
            actions.append(Node(package=package, executable=package, **settings))
    return actions


def generate_launch_description():
    """Arguments and nodes."""
    preset = [FindPackageShare(PACKAGE), "/config/", LaunchConfiguration("preset"), ".yaml"]
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=text)
                for name, (default, text) in ARGUMENTS.items()
            ),
            DeclareLaunchArgument(
                "params_file", default_value=preset, description="parameter file that replaces the preset"
            ),
            OpaqueFunction(function=_refuse_unknown),
            OpaqueFunction(function=_simulation),
            OpaqueFunction(function=_viewers),
        ]
    )
