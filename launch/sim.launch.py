# SPDX-License-Identifier: Apache-2.0
"""Launch file: one simulation node, and on request RViz or foxglove_bridge.

ros2 launch liegroup_sim_ros sim.launch.py scene:=heavy_top record:=/tmp/run.mcap
ros2 launch liegroup_sim_ros sim.launch.py preset:=show rviz:=true
"""

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

PACKAGE = "liegroup_sim_ros"

ARGUMENTS = {
    "scene": ("", "path of a scene file, or name of an example scene; empty: the scene of the preset"),
    "record": ("", "recording file (*.mcap) or existing folder; empty: as in the preset"),
    "frame_prefix": ("", "prefix of the body frame names, such as robot1/; empty: as in the preset"),
    "accuracy": ("", "largest error, such as 1e-6; empty: as in the preset"),
    "accuracy_horizon": ("", "time in which the error may grow by the accuracy, s; empty: as in the preset"),
    "method": ("", "integration method instead of an accuracy, such as rkmk8; empty: as in the preset"),
    "step": ("", "step size, s; empty: as in the preset"),
    "preset": ("default", "name of the file in config/ with the other parameters, such as show"),
    "namespace": ("", "namespace of the node"),
    "clock_topic": ("/clock", "topic of the clock; a second simulation needs another name"),
    "tf_topic": ("/tf", "topic of the transforms"),
    "rviz": ("false", "true: start RViz with config/scene.rviz; use it with preset:=show"),
    "foxglove": ("false", "true: start foxglove_bridge; the layout is config/foxglove.json"),
}
# Topics in config/scene.rviz, relative to the node.
SHOWN = ("markers", "crank/pose_with_covariance", "rod/pose_with_covariance", "slider/pose_with_covariance")
# Arguments that are parameters of the node; a value that is not empty overrides the preset.
TEXTS = ("scene", "record", "frame_prefix", "method")
NUMBERS = ("accuracy", "accuracy_horizon", "step")


def _simulation(context):
    """The simulation node."""
    # A text that looks like a number stays a text.
    overrides = {
        name: ParameterValue(kind(text), value_type=kind)
        for names, kind in ((TEXTS, str), (NUMBERS, float))
        for name in names
        if (text := LaunchConfiguration(name).perform(context))
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
            OpaqueFunction(function=_simulation),
            OpaqueFunction(function=_viewers),
        ]
    )
