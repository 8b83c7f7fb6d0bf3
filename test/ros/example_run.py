# SPDX-License-Identifier: Apache-2.0
"""Small recording with every kind of content, and processes that record, for the tests."""

import json
import os
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import Log
from rclpy.serialization import serialize_message

from liegroup_core.forces.commands import WRENCH, Command
from liegroup_sim_ros.messages import inputs
from liegroup_sim_ros.messages.codecs import ClockCodec, PoseStampedCodec, TwistStampedCodec
from liegroup_sim_ros.recording.write import Recorder

BODIES = ("top", "arm_2")
PUSH = Command(
    WRENCH, "arm_2", (1.0, 2.0, 3.0, 4.0, 5.0, 6.5), 40_000_000, 90_000_000, "wind", "world", (0.0, 0.1, 0.2)
)
TOPICS = {
    "pose": {body: f"/sim_node/{body}/pose" for body in BODIES},
    "twist": {body: f"/sim_node/{body}/twist" for body in BODIES},
    "inputs": "/sim_node/inputs",
    "events": "/sim_node/events",
    "clock": "/clock",
    "diagnostics": "/diagnostics",
}
SCENE = "name: spinning top\ngravity: [0, 0, -9.81]\nbodies: []  # \u03c9\n"
SETTINGS = {"format": 1, "scene": "spinning top", "method": "rkmk4", "topics": TOPICS}
INITIAL = {"bodies": list(BODIES), "pose": [[0.1 + 0.2] * 12] * 2, "twist": [[0.0] * 6] * 2}
PACING = {"ticks": 300, "overruns": 0}
STEP_NS = 1_000_000
STEPS = 1000
START_NS = 2_000_000_000
END_NS = START_NS + STEPS * STEP_NS


def attachments():
    return {
        "scene.yaml": ("application/yaml", SCENE.encode()),
        "settings.json": ("application/json", json.dumps(SETTINGS).encode()),
        "initial_state.json": ("application/json", json.dumps(INITIAL).encode()),
    }


def stamped(message, stamp, stamp_ns):
    stamp.sec, stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
    return serialize_message(message)


def log_message(stamp_ns, name, text):
    message = Log(name=name, msg=text, level=20)
    return stamped(message, message.stamp, stamp_ns)


def diagnostics_message(stamp_ns, values):
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    message = DiagnosticArray(status=[DiagnosticStatus(name="sim", level=b"\x01", values=pairs)])
    return stamped(message, message.header.stamp, stamp_ns)


def record_run(path):
    """Record a run of several chunks with every kind of content; {topic: [(stamp, bytes)]}."""
    random = np.random.default_rng(1)
    written = {}
    with Recorder(path, attachments(), {"run": {"operator": "test"}}) as recorder:
        channels = {}

        def write(topic, stamp_ns, data):
            written.setdefault(topic, []).append((stamp_ns, data))
            recorder.write(channels[topic], stamp_ns, data)

        for topics, codec in ((TOPICS["pose"], PoseStampedCodec), (TOPICS["twist"], TwistStampedCodec)):
            for topic in topics.values():
                channels[topic] = recorder.add_channel(topic, codec.TYPE)
        for name, msg_type, qos in (
            ("inputs", inputs.TYPE, "transient_local"),
            ("events", "rcl_interfaces/msg/Log", "transient_local"),
            ("diagnostics", "diagnostic_msgs/msg/DiagnosticArray", "reliable"),
            ("clock", ClockCodec.TYPE, "best_effort"),
        ):
            channels[TOPICS[name]] = recorder.add_channel(TOPICS[name], msg_type, qos)
        write(TOPICS["events"], START_NS, log_message(START_NS, "start", "spinning top"))
        for i in range(STEPS):
            stamp_ns = START_NS + i * STEP_NS
            write("/clock", stamp_ns, ClockCodec.encode(stamp_ns))
            for body in BODIES:
                write(
                    TOPICS["pose"][body],
                    stamp_ns,
                    PoseStampedCodec("world").encode(stamp_ns, random.normal(size=3), random.normal(size=4)),
                )
                write(TOPICS["twist"][body], stamp_ns, TwistStampedCodec(body).encode(stamp_ns, random.normal(size=6)))
        write(TOPICS["inputs"], END_NS, inputs.encode(START_NS, [PUSH]))
        write(TOPICS["diagnostics"], END_NS, diagnostics_message(END_NS, {"energy": "1.5", "lost": "0"}))
        write(TOPICS["events"], END_NS, log_message(END_NS, "stop", "done"))
        recorder.add_attachment("pacing.json", "application/json", json.dumps(PACING).encode())
    assert recorder.failure is None and recorder.lost == 0 and recorder.queued == 0
    assert recorder.written == sum(map(len, written.values()))
    assert recorder.bytes == Path(path).stat().st_size
    return written


def python(code, *arguments):
    """Python process that runs `code`, which can import this file as `example_run`."""
    path = [str(Path(__file__).parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    return subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code), *map(str, arguments)],
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(path)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
