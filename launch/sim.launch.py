# SPDX-License-Identifier: Apache-2.0
"""Launch file: one simulation node.

ros2 launch liegroup_sim_ros sim.launch.py scene:=heavy_top record:=/tmp/run.mcap
"""
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PACKAGE = "liegroup_sim_ros"


def generate_launch_description():
    """Arguments and node."""
    preset = PathJoinSubstitution([FindPackageShare(PACKAGE), "config", "default.yaml"])
    return LaunchDescription([
        DeclareLaunchArgument("scene", default_value="heavy_top",
                              description="scene file, or name of a scene that comes along"),
        DeclareLaunchArgument("record", default_value="",
                              description="file to record to, *.mcap; empty: no recording"),
        DeclareLaunchArgument("params_file", default_value=preset,
                              description="all other parameters"),
        DeclareLaunchArgument("namespace", default_value="", description="namespace of the node"),
        Node(
            package=PACKAGE, executable="sim_node", name="sim_node", output="screen",
            namespace=LaunchConfiguration("namespace"),
            # Texts, also where they look like numbers.
            parameters=[LaunchConfiguration("params_file")] + [
                {name: ParameterValue(LaunchConfiguration(name), value_type=str)}
                for name in ("scene", "record")]),
    ])
