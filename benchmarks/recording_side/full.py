# SPDX-License-Identifier: Apache-2.0
"""Run a node whose recording fills the disk; prints JSON about its reaction.

full.py FILE
"""

import json
import os
import random
import signal
import subprocess
import sys
import time

os.environ.update(ROS_DOMAIN_ID=str(random.randint(1, 100)), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")

import rclpy  # noqa: E402  (reads the domain from the environment)
from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402

node = subprocess.Popen(
    [
        sys.executable,
        "-c",
        "import sys; from liegroup_sim_ros.node.entry import main; sys.exit(main())",
        "--ros-args",
        "-p",
        "scene:=heavy_top",
        "-p",
        f"record:={sys.argv[1]}",
        "-p",
        "publish_rate:=1000.0",
        "-p",
        "real_time_factor:=5.0",
    ],
    stderr=subprocess.PIPE,
    text=True,
    start_new_session=True,
)
rclpy.init()
listener, figures = rclpy.create_node("listener"), []
listener.create_subscription(
    DiagnosticArray,
    "/diagnostics",
    lambda message: figures.append({pair.key: pair.value for pair in message.status[0].values}),
    10,
)
end = time.monotonic() + 300.0


def until(condition):
    while not condition():
        if time.monotonic() > end or node.poll() is not None:
            node.kill()
            raise SystemExit(f"the disk was not filled: {figures[-1:]}")
        rclpy.spin_once(listener, timeout_sec=0.1)


until(lambda: figures and figures[-1]["recorder_failure"])
first, count = figures[-1], len(figures)
until(lambda: len(figures) > count + 3)
node.send_signal(signal.SIGINT)
errors = node.communicate()[1]
if node.returncode:
    raise SystemExit(f"exit code {node.returncode}: {errors}")
last = figures[-1]
print(
    json.dumps(
        [
            int(first["steps"]),
            int(last["steps"]),
            int(last["recorder_written"]),
            int(last["recorder_lost"]),
            last["recorder_failure"],
            "[ERROR]" in errors and last["recorder_failure"] in errors,
        ]
    )
)
