# SPDX-License-Identifier: Apache-2.0
"""Record poses stamped with the machine's monotonic clock until the process is killed.

writes.py FILE FLUSH_INTERVAL MESSAGES_PER_SECOND
"""

import sys
import time

from liegroup_sim_ros.messages.codecs import PoseStampedCodec
from liegroup_sim_ros.recording.write import Recorder

path, flush_interval, rate = sys.argv[1], float(sys.argv[2]), float(sys.argv[3])
recorder = Recorder(path, {"settings.json": ("application/json", b'{"format": 1}')}, flush_interval=flush_interval)
channel = recorder.add_channel("/sim_node/top/pose", PoseStampedCodec.TYPE)
encode = PoseStampedCodec("world").encode
print("running", flush=True)
start, sent = time.monotonic(), 0
while True:
    due = int((time.monotonic() - start) * rate)
    while sent < due:
        now = time.monotonic_ns()
        recorder.write(channel, now, encode(now, (0.1 * sent, 0, 0), (0, 0, 0, 1)))
        sent += 1
    time.sleep(1e-3)
