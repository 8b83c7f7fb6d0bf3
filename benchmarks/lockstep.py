# SPDX-License-Identifier: Apache-2.0
"""Is lockstep exact under load and after faults, and how fast is it?

    python benchmarks/lockstep.py speed               periods in a second, beside a bare echo of the same controller
    python benchmarks/lockstep.py bits --runs 200     SHA-256 of recordings, with load and random delays
    python benchmarks/lockstep.py faults --runs 100   kill -9 and freezes of either side at random moments

`--robot FILE` replaces four_bar, such as the UR5 of the package example-robot-data.
"""

import argparse
import collections
import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("ROS_DOMAIN_ID", str(random.randint(1, 100)))
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"

import rclpy  # noqa: E402  (reads the domain from the environment)
from geometry_msgs.msg import WrenchStamped  # noqa: E402
from mcap.stream_reader import StreamReader  # noqa: E402
from rcl_interfaces.msg import Log  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from liegroup_core import load_scene  # noqa: E402
from liegroup_sim_ros.playback.resimulate import resimulate  # noqa: E402
from liegroup_sim_ros.recording.read import read_recording  # noqa: E402

SIDE = Path(__file__).parent / "node_side" / "lockstep.py"
NODE = "import sys; from liegroup_sim_ros.node.entry import main; sys.exit(main())"
LIMIT = 0.5  # s, lockstep_timeout
HUNG = 300.0  # s
FIGURES = ("/diagnostics", "/sim_node/state", "/sim_node/events")  # with wall time


class Side(subprocess.Popen):
    """Process with its stderr in a file; `with` kills it."""

    def __init__(self, *command):
        self.log = tempfile.TemporaryFile("a+")  # the process writes at the end, wherever this one reads
        command = [sys.executable, *map(str, command)]
        super().__init__(command, stdout=subprocess.PIPE, stderr=self.log, text=True, start_new_session=True)

    def text(self):
        """What it has logged."""
        self.log.seek(0)
        return self.log.read()

    def __exit__(self, *_):
        if self.poll() is None:
            self.kill()
        self.wait()
        self.stdout.close()


class Run:
    """Node and two controllers; this process is a third one, which lets the run end at an exact time."""

    def __init__(self, watcher, args, path, seconds, chance):
        self._watcher, self._args, self.path, self._seconds, self._chance = watcher, args, path, seconds, chance
        joints = args.joints
        self.tasks = [
            {"topic": "joint_commands", "rate": 1000.0, "gains": [30.0, 5.0], "joints": joints},
            {"topic": "joint_commands/slow", "rate": 100.0, "gains": [-10.0, 1.0], "joints": joints[:1]},
        ]
        self.sides = []

    def node(self, **more):
        """Start the node."""
        lockstep = ",".join([f"{t['topic']}@{t['rate']:g}" for t in self.tasks] + [f"wrench/end@{1.0 / self._seconds}"])
        parameters = {
            **{"scene": self._args.robot, "method": "rkmk4", "step": 1e-3, "estimate": "false"},
            **{"real_time_factor": 0.0, "lockstep": lockstep, "lockstep_timeout": LIMIT, "publish_rate": 100.0},
            **{"record": self.path, "marker_rate": 0.0, "record_flush_interval": 0.2},
            **more,
        }
        return Side("-c", NODE, "--ros-args", *(x for k, v in parameters.items() for x in ("-p", f"{k}:={v}")))

    def controller(self, k):
        """Start a controller."""
        return Side(SIDE, "controller", json.dumps(self.tasks[k] | {"chance": self._chance, "longest": 0.01}))

    def __enter__(self):
        self._watcher.begin(self._seconds, self._args.body)
        self.sides = [self.node(), self.controller(0), self.controller(1)]
        return self

    def __exit__(self, *exception):
        for side in self.sides:
            side.__exit__()

    def end(self):
        """End the node in order; returns what it has logged."""
        self.sides[0].send_signal(signal.SIGINT)
        assert self.sides[0].wait(60) == 0, self.sides[0].text()
        return self.sides[0].text()


class Watcher:
    """Third controller: it answers at 0, and again for a new node, but not at the end."""

    def __init__(self):
        rclpy.init()
        self.node = rclpy.create_node("watcher")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self.node.create_subscription(Clock, "/clock", self._hear, 10)
        latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.events = []
        self.node.create_subscription(Log, "/sim_node/events", self.events.append, latched)
        self._publisher = self.node.create_publisher(WrenchStamped, "/sim_node/wrench/end", 10)
        self._resume = self.node.create_client(Trigger, "/sim_node/resume")
        self.begin(1.0, "")

    def begin(self, seconds, body):
        """Prepare for a run; what the last one has sent is read first."""
        self.until_wall(0.5)
        self.now, self._end = 0, round(seconds * 1e9)
        self._message = WrenchStamped()
        self._message.header.frame_id = body
        self.events.clear()

    def _hear(self, message):
        self.now = message.clock.sec * 10**9 + message.clock.nanosec
        if self.now == 0:
            self._publisher.publish(self._message)

    def until(self, condition, sides, what):
        """Spin until a condition; fails if it takes HUNG or the node ends; returns s of wall time."""
        began = time.monotonic()
        while not condition():
            self._executor.spin_once(timeout_sec=0.02)
            if time.monotonic() - began > HUNG or sides[0].poll() is not None:
                raise RuntimeError(f"no {what}: {self.now} {[side.text()[-500:] for side in sides]}")
        return time.monotonic() - began

    def until_wall(self, seconds):
        """Spin for s of wall time."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.05)

    def until_time(self, now, sides):
        """Spin until a simulated time in ns; a busy machine may let a controller miss the limit: that is resumed."""

        def reached():
            if self.now < min(now, self._end) and any("paused" in event.msg for event in self.events):
                print(f"    {self.events[-1].msg}", flush=True)
                self.events.clear()
                self.resume(sides)
            return self.now >= min(now, self._end)

        return self.until(reached, sides, f"state at {now}")

    def resume(self, sides):
        """Resume until that is confirmed."""
        futures = []

        def resumed():
            if not futures or len(futures) < 50 and time.monotonic() > futures[-1][1] + 2.0:
                futures.append((self._resume.call_async(Trigger.Request()), time.monotonic()))
            return any(future.done() for future, _ in futures)

        self.until(resumed, sides, "answer of resume")


def messages(path):
    """{topic: [(stamp, data)]} of a recording, of a truncated one what can be read."""
    found, channels = collections.defaultdict(list), {}
    with open(path, "rb") as file:
        try:
            for record in StreamReader(file, emit_chunks=False).records:
                kind = type(record).__name__
                if kind == "Channel":
                    channels[record.id] = record.topic
                elif kind == "Message" and channels[record.channel_id] not in FIGURES:
                    found[channels[record.channel_id]].append((record.log_time, record.data))
        except Exception as error:
            print(f"    truncated: {type(error).__name__}")
    return found


def digest(found):
    """SHA-256 of messages."""
    sha = hashlib.sha256()
    for topic, entries in sorted(found.items()):
        sha.update(topic.encode())
        for stamp, data in entries:
            sha.update(stamp.to_bytes(8, "little") + data)
    return sha.hexdigest()


def checked(path):
    """Recording of a run that ended in order, after checks of its periods."""
    recording = read_recording(path)
    assert recording.complete and not recording.lost, path
    starts = collections.defaultdict(set)
    for command in recording.inputs:
        starts[command.source].add((command.start_ns, command.end_ns))
    for source, period in (("joint_commands", 10**6), ("joint_commands/slow", 10**7)):
        assert starts[source] == {(k, k + period) for k in range(0, recording.last_ns, period)}, source
    return recording


class Load:
    """Busy processes."""

    def __init__(self, count):
        self._sides = [Side("-c", "while True: pass") for _ in range(count)]

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for side in self._sides:
            side.__exit__()


def bits(args, watcher, folder):
    """Runs of 10 s."""
    found, walls = collections.Counter(), []
    with Load(args.load):
        for k in range(args.runs):
            path = folder / f"{k}.mcap"
            with Run(watcher, args, path, args.seconds, args.chance) as run:
                watcher.until_time(1, run.sides)
                walls.append(watcher.until_time(args.seconds * 1e9, run.sides))
                log = run.end()
            found[digest(messages(path))] += 1
            recording = checked(path)
            assert recording.last_ns == args.seconds * 1e9, recording.last_ns
            if k % 10 == 0:
                figures = resimulate(recording)
                assert figures["identical"] == figures["samples"], figures
            path.unlink()
            rate = args.seconds * 1000 / walls[-1]
            print(f"{k + 1} runs, {rate:.0f} periods/s, {dict(found)}", "" if "answer" not in log else log, flush=True)
    print(f"{args.runs} runs of {args.seconds:g} s: {len(found)} SHA-256; {min(walls):.1f}-{max(walls):.1f} s each")


def faults(args, watcher, folder):
    """Faults at random moments."""
    with Run(watcher, args, folder / "reference.mcap", args.seconds, 0.0) as run:
        watcher.until_time(args.seconds * 1e9, run.sides)
        run.end()
    reference = messages(folder / "reference.mcap")
    wanted, said = digest(reference), collections.defaultdict(list)
    for k in range(args.runs):
        path, who, kind = folder / f"{k}.mcap", random.choice((0, 1, 1, 2)), random.choice(("kill", "freeze"))
        with Run(watcher, args, path, args.seconds, 0.0) as run:
            watcher.until_time(random.uniform(0.02, 0.95) * args.seconds * 1e9, run.sides)
            at, side = watcher.now, run.sides[who]
            before = [each.text().count("no state of the simulation") for each in run.sides[1:]]
            watcher.events.clear()
            side.send_signal(signal.SIGKILL if kind == "kill" else signal.SIGSTOP)

            def heard(who=who, run=run, before=before):
                if who:
                    return any("paused" in event.msg for event in watcher.events)
                counts = [each.text().count("no state of the simulation") for each in run.sides[1:]]
                return all(now > then for now, then in zip(counts, before))

            name = f"{('node', 'controller', 'controller')[who]} {kind}"
            said[name].append(watcher.until(heard, run.sides if who else [run.sides[1]], "event"))
            if kind == "freeze":
                watcher.until_wall(random.choice((0.0, 3.0)))
                side.send_signal(signal.SIGCONT)
            elif who:
                side.__exit__()
                run.sides[who] = run.controller(who - 1)
            if who == 0 and kind == "kill":
                side.wait()
                rest = messages(path)
                for topic, entries in rest.items():
                    assert reference[topic][: len(entries)] == entries, topic
                saved = rest["/clock"][-1][0] if rest["/clock"] else 0
                print(f"    killed at {at / 1e9:.3f} s, recorded up to {saved / 1e9:.3f} s")
                assert saved >= at - 10**6  # all answered states
                path.unlink()
                run.sides[0] = run.node()
                watcher.now = 0
            elif who:
                watcher.events.clear()
                watcher.resume(run.sides)
            watcher.until_time(args.seconds * 1e9, run.sides)
            run.end()
        same = digest(messages(path)) == wanted
        checked(path)
        path.unlink()
        print(f"{k + 1}: {name}: said after {said[name][-1]:.2f} s, same bits: {same}", flush=True)
        assert same
    for name, times in said.items():
        print(f"{name}: {len(times)}, said after at most {max(times):.2f} s")


def speed(args, watcher, folder):
    """Periods in a second of one controller, alternating with a bare echo of it; the best of each on a busy machine."""
    found = []
    for k in range(args.runs):
        run = Run(watcher, args, "", args.seconds, 0.0)
        run.tasks, rates = run.tasks[:1], []
        with run.controller(0), Side(SIDE, "bare", json.dumps({"joints": args.joints, "seconds": 5.0})) as echo:
            rates.append(float(echo.communicate(timeout=HUNG)[0]))
        for path in ("''", folder / f"{k}.mcap"):
            run.path = path
            watcher.begin(args.seconds, args.body)
            with run.node(clock_rate=10.0) as node, run.controller(0) as controller:
                watcher.until_time(0.1e9, [node, controller])
                began = watcher.now
                seconds = watcher.until_time(args.seconds * 1e9, [node, controller])
                rates.append((args.seconds * 1e3 - began * 1e-6) / seconds)
        found.append(rates)
        print("echo {:.0f}/s, lockstep {:.0f}/s, recorded {:.0f}/s".format(*rates), flush=True)
    echo, lockstep, recorded = map(max, zip(*found))
    print(f"best: echo {echo:.0f}/s, lockstep {lockstep / echo:.2f} of that, recorded {recorded / echo:.2f}")


def main():
    """Run one part."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=("speed", "bits", "faults"))
    parser.add_argument("--robot", default="four_bar")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=10.0, help="simulated")
    parser.add_argument("--load", type=int, default=2 * os.cpu_count(), help="busy processes")
    parser.add_argument("--chance", type=float, default=0.01, help="of a delay up to 10 ms of an answer")
    args = parser.parse_args()
    scene = load_scene(args.robot)
    args.joints = [scene.joints[0].name] if scene.robot is None else [j.name for j in scene.joints]
    args.body = scene.bodies[0].name
    watcher = Watcher()
    with tempfile.TemporaryDirectory() as folder:
        {"speed": speed, "bits": bits, "faults": faults}[args.part](args, watcher, Path(folder))


if __name__ == "__main__":
    main()
