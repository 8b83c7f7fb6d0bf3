# SPDX-License-Identifier: Apache-2.0
"""Test that colcon builds this package, and that ROS 2 finds and runs the result.

Runs `colcon build` in a temporary workspace and takes the environment from its setup.bash alone.
The ament index must then name the new prefix. `ros2 run` and launch files start
<prefix>/lib/liegroup_sim_ros/sim_node: this process must receive its messages over DDS, and one
SIGINT must end it with exit code 0.
"""

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

NAME = "liegroup_sim_ros"
REPOSITORY = Path(__file__).resolve().parents[1]
# Not the colcon on the PATH: the executables get the Python that runs colcon.
COLCON = [sys.executable, "-c", "from colcon_core.command import main; raise SystemExit(main())"]
# Discovery takes up to 2.5 s; compiling the kernels for the first time a minute or two.
DEADLINE_S = 120.0
STOP_S = 15.0


def build(workspace):
    """Build the repository with colcon; return the prefix of the package."""
    subprocess.run(
        [
            *COLCON,
            "--log-base",
            workspace / "log",
            "build",
            "--base-paths",
            REPOSITORY,
            "--build-base",
            workspace / "build",
            "--install-base",
            workspace / "install",
        ],
        cwd=workspace,
        check=True,
        timeout=300,
    )
    return workspace / "install" / NAME


def sourced_environment(workspace):
    """Environment of a clean shell after sourcing the workspace."""
    printed = subprocess.run(
        ["bash", "-c", "source install/setup.bash && exec env -0"],
        cwd=workspace,
        check=True,
        env={"HOME": os.environ["HOME"], "PATH": "/usr/bin:/bin"},
        stdout=subprocess.PIPE,
    )
    return dict(entry.split("=", 1) for entry in printed.stdout.decode().split("\0") if entry)


def wait_for_pose(node):
    """Wait for the first pose from the process `node` over DDS; returns the waiting time in s."""
    import rclpy
    from geometry_msgs.msg import PoseStamped

    rclpy.init()
    poses = []
    listener = rclpy.create_node("listener")
    listener.create_subscription(PoseStamped, "/sim_node/top/pose", poses.append, 10)
    start = time.monotonic()
    while not poses:
        rclpy.spin_once(listener, timeout_sec=0.1)
        assert node.poll() is None, f"the node ended by itself, exit code {node.returncode}"
        assert time.monotonic() - start < DEADLINE_S, f"no pose within {DEADLINE_S:.0f} s"
    rclpy.shutdown()
    return time.monotonic() - start


def prove(workspace):
    prefix = build(workspace)
    environment = sourced_environment(workspace)

    # In this process too: the ament index and DDS read the environment when they are used.
    os.environ["AMENT_PREFIX_PATH"] = environment["AMENT_PREFIX_PATH"]
    domain = {"ROS_DOMAIN_ID": str(random.randint(1, 100)), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    os.environ.update(domain)
    environment.update(domain)

    from ament_index_python.packages import get_package_prefix

    assert get_package_prefix(NAME) == str(prefix), get_package_prefix(NAME)

    code = subprocess.run(
        [sys.executable, "-P", "-c", f"import {NAME}; print({NAME}.__file__)"],
        env=environment,
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    ).stdout
    assert code.startswith(str(prefix)), f"the code would come from {code}"

    node = subprocess.Popen(
        [prefix / "lib" / NAME / "sim_node", "--ros-args", "-p", "scene:=heavy_top"],
        env=environment,
        start_new_session=True,
    )
    try:
        seconds = wait_for_pose(node)
        os.killpg(node.pid, signal.SIGINT)
        exit_code = node.wait(STOP_S)
        assert exit_code == 0, f"exit code {exit_code} after SIGINT"
    finally:
        if node.poll() is None:
            os.killpg(node.pid, signal.SIGKILL)
            node.wait()
    print(
        f"colcon: {prefix / 'lib' / NAME / 'sim_node'} built, found, "
        f"first pose after {seconds:.1f} s, exit code 0 at SIGINT"
    )


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        prove(Path(folder).resolve())
