# SPDX-License-Identifier: Apache-2.0
"""Time and memory of reading and analysing a long recording: an hour at 1 kHz of a heavy top.

    python benchmarks/recording_analysis.py [--seconds 3600] [--keep FILE]

The recording is written as fast as possible, with pose, twist and clock of every step and an
applied wrench every ten minutes. Each part then runs in its own process. Peak memory is VmHWM
(ru_maxrss includes that of the parent); the last column excludes the memory of the imports.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

STEP = 1e-3
PARTS = {
    "imports": "import liegroup_sim_ros.commands.analyze",
    "read_recording": "read()",
    "samples, piece by piece": "print(sum(len(piece.stamp_ns) for piece in read().samples()), file=sys.stderr)",
    "all tracks as arrays": "r = read(); r.pose, r.twist",
    "analyze --no-reference": "analyse(read(), reference=False)",
    "analyze": "found = analyse(read()); print(found.figures['verdict'], file=sys.stderr)",
}
CHILD = """
import json, sys, time
start = time.perf_counter()
from liegroup_sim_ros.analysis.analyse import analyse
from liegroup_sim_ros.recording.read import read_recording
read = lambda: read_recording(sys.argv[1])
started = time.perf_counter(), time.process_time()
{code}
wall, cpu = time.perf_counter() - started[0], time.process_time() - started[1]
peak = next(int(line.split()[1]) for line in open("/proc/self/status") if line[:5] == "VmHWM")
print(json.dumps([wall, cpu, peak / 1024]))
"""


def make(path, seconds):
    """Record a run; returns the number of messages."""
    from liegroup_core import Simulation, load_scene
    from liegroup_sim_ros.messages import inputs
    from liegroup_sim_ros.messages.codecs import ClockCodec, LogCodec, PoseStampedCodec, TwistStampedCodec
    from liegroup_sim_ros.recording import attachments
    from liegroup_sim_ros.recording.write import Recorder

    simulation = Simulation(load_scene("heavy_top"), "rkmk4", STEP)
    topics = {
        "pose": {"top": "/sim_node/top/pose"},
        "twist": {"top": "/sim_node/top/twist"},
        "inputs": "/sim_node/inputs",
        "events": "/sim_node/events",
        "clock": "/clock",
        "diagnostics": "/diagnostics",
    }
    with Recorder(path, attachments.at_start(simulation, "/sim_node", "world", 1, topics)) as recorder:
        pose, twist, given, events, clock = (
            recorder.add_channel(topic, codec.TYPE)
            for topic, codec in (
                (topics["pose"]["top"], PoseStampedCodec),
                (topics["twist"]["top"], TwistStampedCodec),
                (topics["inputs"], inputs),
                (topics["events"], LogCodec),
                ("/clock", ClockCodec),
            )
        )
        encode_pose = PoseStampedCodec("world").encode
        encode_twist = TwistStampedCodec("top").encode
        recorder.write(events, 0, LogCodec.encode(0, LogCodec.INFO, "start", "benchmark"))
        for step in range(round(seconds / STEP) + 1):
            if step:
                if step % 600_000 == 1000:
                    simulation.apply_wrench("top", (0, 0, 0, 0, 100.0, 0), duration=0.2)
                simulation.advance()
            sample = simulation.sample()
            stamp = sample.time_ns
            if commands := simulation.drain_applied():
                recorder.write(given, stamp, inputs.encode(0, commands))
            recorder.write(clock, stamp, ClockCodec.encode(stamp))
            recorder.write(
                pose, stamp, encode_pose(stamp, sample.positions["top"].tolist(), sample.quaternions["top"].tolist())
            )
            recorder.write(twist, stamp, encode_twist(stamp, sample.twists["top"].tolist()))
        recorder.write(events, stamp, LogCodec.encode(stamp, LogCodec.INFO, "stop", "done"))
    if recorder.failure:
        sys.exit(recorder.failure)
    return recorder.written


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=3600.0, help="simulated time")
    parser.add_argument("--keep", metavar="FILE", help="recording to write, or to analyse if it exists")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(args.keep or Path(folder) / "long.mcap")
        start = time.perf_counter()
        if not path.exists():
            make(path, args.seconds)
            print(f"recorded in {time.perf_counter() - start:.0f} s")
        from liegroup_sim_ros.recording.read import read_recording

        million = sum(read_recording(path).topics.values()) / 1e6
        print(f"{million:.3f} million messages, {path.stat().st_size / 2**20:.0f} MiB\n")
        print(f"{'':26}{'wall s':>9}{'cpu s':>9}{'peak MB':>9}{'s / 1e6':>9}{'MB / 1e6':>10}")
        base = None
        for name, code in PARTS.items():
            done = subprocess.run(
                [sys.executable, "-c", CHILD.format(code=code), str(path)], stdout=subprocess.PIPE, text=True
            )
            if done.returncode:
                sys.exit(f"{name} failed")
            wall, cpu, peak = json.loads(done.stdout.splitlines()[-1])
            base = peak if base is None else base
            print(
                f"{name:26}{wall:9.1f}{cpu:9.1f}{peak:9.0f}{wall / million:9.2f}{(peak - base) / million:10.1f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
