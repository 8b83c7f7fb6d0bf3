# SPDX-License-Identifier: Apache-2.0
"""Start a node that records all topics, with a wrench and a pause.

all_topics.py FILE
"""

import importlib.util
import os
import random
import signal
import subprocess
import sys
import time

os.environ.update(ROS_DOMAIN_ID=str(random.randint(1, 100)), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")

import rclpy  # noqa: E402  (reads the domain from the environment)
from geometry_msgs.msg import WrenchStamped  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

RATES = ["odometry", "velocity", "joint_state", "marker", "state"]
if importlib.util.find_spec("tf2_msgs"):
    RATES.append("tf")
node = subprocess.Popen(
    [
        sys.executable,
        "-c",
        "import sys; from liegroup_sim_ros.node.entry import main; sys.exit(main())",
        "--ros-args",
        "-p",
        "scene:=four_bar",
        "-p",
        f"record:={sys.argv[1]}",
        *(part for rate in RATES for part in ("-p", f"{rate}_rate:=50.0")),
    ],
    start_new_session=True,
)
rclpy.init()
client = rclpy.create_node("client")
applied = []
kept = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
client.create_subscription(String, "/sim_node/inputs", applied.append, kept)
publisher = client.create_publisher(WrenchStamped, "/sim_node/wrench", 10)
pause = client.create_client(Trigger, "/sim_node/pause")
end = time.monotonic() + 600.0
message = WrenchStamped()


def until(condition):
    while not condition():
        if time.monotonic() > end or node.poll() is not None:
            node.kill()
            raise SystemExit("the node did not answer")
        rclpy.spin_once(client, timeout_sec=0.05)


until(
    lambda: (
        pause.service_is_ready() and publisher.get_subscription_count() and client.count_publishers("/sim_node/inputs")
    )
)
prefix, suffix = "/sim_node/", "/pose"
message.header.frame_id = next(
    name[len(prefix) : -len(suffix)] for name, _ in client.get_topic_names_and_types() if name.endswith(suffix)
)
message.wrench.force.x = 1.0
publisher.publish(message)
until(lambda: applied)
future = pause.call_async(Trigger.Request())
until(future.done)
until(lambda wait=time.monotonic() + 1.5: time.monotonic() > wait)  # for /diagnostics
node.send_signal(signal.SIGINT)
sys.exit(node.wait(30.0))
