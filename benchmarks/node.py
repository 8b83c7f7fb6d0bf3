# SPDX-License-Identifier: Apache-2.0
"""The simulation node over DDS, compared with bare rclpy loops in the same run.

    python benchmarks/node.py            a few seconds for each part
    python benchmarks/node.py --long     60 and 30 s, as for the published figures

On a machine with other load, only ratios of the real-time figures are meaningful.
"""

import argparse
import json
import os
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("ROS_DOMAIN_ID", str(random.randint(1, 100)))
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"

import rclpy  # noqa: E402  (reads the domain from the environment)
from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from geometry_msgs.msg import TwistStamped, WrenchStamped  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402

from liegroup_core.scene.library import chain  # noqa: E402
from liegroup_sim_ros.recording.read import read_recording  # noqa: E402

BARE = Path(__file__).parent / "node_side" / "bare.py"
NODE = "import sys; from liegroup_sim_ros.node.entry import main; sys.exit(main())"
STARTING = 240.0  # s; the first start on a machine compiles
HELD = 0.999  # real-time factor that counts as held
PUCK = (
    "name: table\ngravity: [0, 0, 0]\nbodies:\n  - {name: puck, mass: 1, inertia: [1, 1, 1]}\n"
    "  - {name: wheel, mass: 1, inertia: [1, 1, 1]}\njoints:\n"
    "  - {name: axle, type: revolute, parent: world, child: wheel, child_frame: {}}\n"
)


def many(count):
    """Scene of free bodies."""
    return "name: many\ngravity: [0, 0, -9.81]\nbodies:\n" + "".join(
        f"  - {{name: b{i}, mass: 1, inertia: [1, 2, 3], position: [{i}, 0, 0], angular_velocity: [1, 2, 3]}}\n"
        for i in range(count)
    )


class Process:
    """Process with readable CPU time and memory; `with` stops it."""

    def __init__(self, *command):
        self._process = subprocess.Popen(
            [sys.executable, *map(str, command)], text=True, stdout=subprocess.PIPE, start_new_session=True
        )

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            try:
                self._process.wait(10.0)
            except subprocess.TimeoutExpired:
                self._process.kill()

    def end(self):
        """Exit code after SIGINT."""
        self._process.send_signal(signal.SIGINT)
        try:
            return self._process.wait(30.0)
        except subprocess.TimeoutExpired:
            raise SystemExit("node.py: a process did not end within 30 s") from None

    def answer(self):
        """JSON printed by the process at its end."""
        return json.loads(self._process.communicate()[0])

    def cpu(self):
        """CPU seconds so far."""
        fields = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def memory(self):
        """Resident memory, MB."""
        pages = Path(f"/proc/{self._process.pid}/statm").read_text().split()[1]
        return int(pages) * os.sysconf("SC_PAGE_SIZE") / 1e6


def simulation(**parameters):
    return Process(
        "-c", NODE, "--ros-args", *(part for name, value in parameters.items() for part in ("-p", f"{name}:={value}"))
    )


class Listener:
    """ROS node in this process that subscribes and calls services."""

    def __init__(self):
        rclpy.init()
        self.node = rclpy.create_node("benchmark")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self.diagnostics = []
        self.node.create_subscription(
            DiagnosticArray, "/diagnostics", lambda message: self.diagnostics.append(message), 10
        )

    def until(self, condition, seconds=STARTING):
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > end:
                raise SystemExit("node.py: a process did not answer")
            self._executor.spin_once(timeout_sec=0.05)

    def spin(self, seconds):
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)

    def figures(self):
        """Values of the next diagnostics message."""
        count = len(self.diagnostics)
        self.until(lambda: len(self.diagnostics) > count)
        return {pair.key: pair.value for pair in self.diagnostics[-1].status[0].values}


def paced(listener, folder, seconds, name, parameters, push=False):
    """Real-time run with pose, twist, /clock and recording; prints one line of figures and its events.

    push : True: a force of 50 N on the first body, once a second
    """
    path = folder / f"{name.replace(' ', '_')}.mcap"
    with simulation(**parameters, record=path) as node:
        publisher = listener.node.create_publisher(WrenchStamped, "/sim_node/wrench", 10)
        first, cpu = listener.figures(), node.cpu()
        if push:
            listener.until(publisher.get_subscription_count)
            for _ in range(round(seconds)):
                publisher.publish(pushed(50.0, "top"))
                listener.spin(1.0)
        else:
            listener.spin(seconds)
        last = listener.figures()
        cpu = node.cpu() - cpu
        node.end()
        listener.node.destroy_publisher(publisher)
    recording = read_recording(path)
    simulated = float(last["sim_time_s"]) - float(first["sim_time_s"])
    wall = recording.pacing["wall_seconds"]
    track = recording.pose[recording.bodies[0]]
    line(name, recording.pacing, (len(track.stamp_ns) - 1) / wall, cpu / simulated)
    if not recording.complete or recording.lost:
        raise SystemExit(f"node.py: {name}: the recording is not complete")
    if push and int(last["wrenches_accepted"]) != round(seconds):
        raise SystemExit(f"node.py: {name}: {last['wrenches_accepted']} pushes were taken")
    for event in recording.events:
        if event.name in ("accuracy", "inaccurate", "unpredictable", "slow"):
            print(f"    {event.stamp_ns * 1e-9:8.3f} s {event.name}: {event.text}")


def at(rate):
    return {"publish_rate": rate, "clock_rate": rate}


def line(name, pacing, rate, cpu):
    late = pacing["lateness_us"]
    print(
        f"{name:<24} {rate:9.2f} {late['p50']:8.1f} {late['p99']:8.1f} {late['max']:9.0f} "
        f"{100 * cpu:7.1f} {pacing['real_time_factor']:9.5f}"
    )


def real_time(listener, folder, seconds):
    print("\nin real time                 rate/s  late p50      p99       max   CPU %   rt factor   (lateness in us)")
    paced(listener, folder, seconds, "heavy top", {"scene": "heavy_top", **at(1000.0)})
    scene = folder / "many.yaml"
    scene.write_text(many(20))
    paced(listener, folder, seconds, "20 bodies", {"scene": scene, **at(500.0)})
    with Process(BARE, "paced", seconds) as bare:
        answer = bare.answer()
    line("bare loop, ready bytes", answer, answer["ticks"] / answer["wall_seconds"], answer["cpu"])


def holds(listener, folder, seconds, kind, links):
    """Whether a chain runs in real time with poses and twists of every body published at 100 Hz."""
    scene, path = folder / f"{kind}{links}.yaml", folder / f"{kind}{links}.mcap"
    # Long links fall slowly: the free end of short ones is too fast for steps of 1 ms.
    scene.write_text(chain(links, kind, length=10.0).text)
    with simulation(scene=scene, record=path) as node:
        listener.figures()  # of this node, the previous one has ended
        cpu = node.cpu()
        listener.spin(seconds)
        cpu = node.cpu() - cpu
        node.end()
    recording = read_recording(path)
    path.unlink()
    if not recording.complete or recording.lost or "fault" in (e.name for e in recording.events):
        raise SystemExit(f"node.py: {links} links: the run failed before its end")
    pacing = recording.pacing
    factor = pacing["real_time_factor"]
    print(
        f"{kind:<12} {links:8d} {factor:15.5f} {pacing['lateness_us']['p99']:9.0f} {100 * cpu / seconds:7.1f}",
        flush=True,
    )
    return factor >= HELD


def kept(listener, folder, seconds):
    """A node at 1 kHz with a push every second, with and without the estimate; a scene that is too large."""
    print("\naccuracy, recorded           rate/s  late p50      p99       max   CPU %   rt factor   (lateness in us)")
    heavy = {"scene": "heavy_top", **at(1000.0)}
    fixed = {**heavy, "method": "rkmk853", "step": 1e-3}
    paced(listener, folder, seconds, "default", heavy, push=True)
    paced(listener, folder, seconds, "rkmk853", fixed, push=True)
    paced(listener, folder, seconds, "no estimate", {**fixed, "estimate": False}, push=True)
    large = folder / "large.yaml"
    large.write_text(chain(600, "spherical", length=10.0).text)
    slow = {"scene": large, "publish_rate": 10.0}
    paced(listener, folder, seconds, "600 links, 1e-9", {**slow, "accuracy": 1e-9})
    fixed = {**slow, "method": "rkmk4", "step": 1e-2, "estimate": False}
    paced(listener, folder, seconds, "600 links, rkmk4", fixed)


def largest(listener, folder, seconds):
    print(
        "\nlargest chain at 100 Hz, poses and twists of all bodies published and recorded\n"
        "joints          links       rt factor  late p99   CPU %   (steps of 1 ms)"
    )
    for kind in ("spherical", "revolute"):

        def good_enough(links, kind=kind):  # two attempts: another process may disturb one
            return any(holds(listener, folder, seconds, kind, links) for _ in range(2))

        good, links = 0, 50
        while good_enough(links):
            good, links = links, 2 * links
        while links - good > 0.1 * links:  # bisection between a length that holds and one that does not
            middle = (good + links) // 2
            if good_enough(middle):
                good = middle
            else:
                links = middle
        print(f"{kind:<12} {good:8d} links hold real time: factor at least {HELD}")


def trips(listener, out, back, count, pause=2e-3):
    """Latency in us from publishing a command to receiving the state that shows its effect.

    pause : s, least time between two commands; the largest is twice as much
    out  : topic, function: number -> message
    back : topic, message class, function: message -> number
    """
    seen = []
    (commanded, make), (shown, message_class, value) = out, back
    subscription = listener.node.create_subscription(message_class, shown, lambda m: seen.append(value(m)), 10)
    publisher = listener.node.create_publisher(type(make(0.0)), commanded, 10)
    listener.until(lambda: publisher.get_subscription_count() and listener.node.count_publishers(shown))
    times, sign = [], 1.0
    listener.spin(1.0)
    for _ in range(count):
        listener.spin(random.uniform(pause, 2.0 * pause))
        message, sign = make(sign), -sign
        before = seen[-1] if seen else None
        seen.clear()
        start = time.perf_counter()
        publisher.publish(message)
        listener.until(lambda: any(x != before for x in seen), 10.0)
        times.append(1e6 * (time.perf_counter() - start))
    listener.node.destroy_subscription(subscription)
    return times


def pushed(force, body="puck"):
    """Push to and fro: the speed in the node is 0, v, 0, v; the echo returns the force itself."""
    message = WrenchStamped()
    message.header.frame_id, message.wrench.force.x = body, force
    return message


def round_trip(listener, folder, count):
    print("\ncommand out, state back      us p50       p99   relative to the echo")
    scene = folder / "puck.yaml"
    scene.write_text(PUCK)
    ratios = []

    def report(name, times, echo=None):
        p50, p99 = statistics.median(times), sorted(times)[int(0.99 * len(times))]
        ratio = ""
        if echo is not None:
            ratios.append(p50 / echo)
            ratio = f"{ratios[-1]:11.2f}"
        print(f"{name:<24} {p50:10.0f} {p99:9.0f} {ratio}")
        return p50

    def speed(message):
        return message.twist.linear.x

    def driven(x):
        return JointState(name=["axle"], effort=[x])

    def effort(message):
        return message.effort[0]

    # The node sends the first state after a command before its tick. The echo runs on the same machine as the
    # node, at the same time and with the same pauses.
    for rate in (50.0, 100.0, 500.0, 1e3, 5e3):
        name, step, pause = f"{rate:g} Hz", min(1e-3, 1.0 / rate), max(2e-3, 2.0 / rate)
        with (
            simulation(
                scene=scene,
                step=step,
                publish_rate=rate,
                joint_state_rate=rate,
                wrench_hold="timeout",
                wrench_timeout=1e-3,
            ),
            Process(BARE, "echo"),
        ):
            listener.figures()
            for kind, command, make, state, message_class, value in (
                ("wrench", "wrench", pushed, "puck/twist", TwistStamped, speed),
                ("effort", "joint_commands", driven, "joint_states", JointState, effort),
            ):
                echo = None
                for who in ("echo", "sim_node"):
                    out, back = ((f"/{who}/{command}", make), (f"/{who}/{state}", message_class, value))
                    times = trips(listener, out, back, count, pause)
                    echo = report(f"{who}, {name}, {kind}", times, echo)
    print(f"median over the rates {statistics.median(ratios):.2f}")


def cost_of(listener, path, seconds, scene, bodies):
    """CPU us per published message, of the whole process with steps and recording."""
    with simulation(
        scene=scene,
        publish_rate=1000.0,
        clock_rate=1000.0,
        state_rate=0.0,
        marker_rate=0.0,
        real_time_factor=0.0,
        record=path,
    ) as node:
        first, cpu = listener.figures(), node.cpu()
        listener.spin(seconds)
        last = listener.figures()
        cpu = node.cpu() - cpu
    # Each step publishes the pose and the twist of every body, and a clock.
    return 1e6 * cpu / ((2 * bodies + 1) * (int(last["steps"]) - int(first["steps"])))


def cost(listener, folder, seconds):
    scene = folder / "many.yaml"
    scene.write_text(many(20))
    costs = {
        "node, heavy top": cost_of(listener, folder / "c1.mcap", seconds, "heavy_top", 1),
        "node, 20 bodies": cost_of(listener, folder / "c20.mcap", seconds, scene, 20),
    }
    bare = {}
    for name in ("objects", "bytes"):
        with Process(BARE, name, seconds) as process:
            bare[name] = process.answer()["cpu_us_per_message"]
    print("\nCPU per message, flat out        us   of objects    of bytes")
    for name, cpu in (*costs.items(), ("bare: objects built", bare["objects"]), ("bare: ready bytes", bare["bytes"])):
        print(f"{name:<26} {cpu:8.2f} {cpu / bare['objects']:12.2f} {cpu / bare['bytes']:11.2f}")


def started(listener, parameters):
    """(running node, s from its start to its first /clock)."""
    clock = []
    subscription = listener.node.create_subscription(Clock, "/clock", clock.append, 10)
    start = time.monotonic()
    node = simulation(**parameters)
    listener.until(lambda: clock)
    listener.node.destroy_subscription(subscription)
    return node, time.monotonic() - start


def bodies(listener, folder, seconds):
    """Start and CPU against the number of free bodies, with arrays or topics of every body; then other defaults."""
    print(
        "\nstart and CPU                    start s   CPU %   end s   memory MB   (medians of 3 runs, poses at 100 Hz)"
    )
    cases = []
    for count in (1, 10, 20, 40, 100, 200, 400):
        scene = folder / f"many{count}.yaml"
        scene.write_text(many(count))
        cases += [(f"{count} bodies, {own}", {"scene": scene, "body_topics": own}) for own in ("none", "all")]
    robot = Path(__file__).parent.parent / "docs" / "robots" / "stewart.sdf"
    none = {"joint_state_rate": 0.0, "marker_rate": 0.0}
    for name, scene in (("heavy top", "heavy_top"), ("stewart.sdf", robot), ("400 bodies", folder / "many400.yaml")):
        cases += [(name, {"scene": scene}), (f"{name}, no joints, markers", {"scene": scene, **none})]
    rows = {name: [] for name, _ in cases}
    for name, parameters in cases * 3:
        node, start = started(listener, parameters)
        with node:
            listener.spin(2.0)  # until all topics are found
            cpu = node.cpu()
            listener.spin(seconds)
            cpu, end = node.cpu() - cpu, time.monotonic()
            memory = node.memory()
            node.end()
        rows[name].append((start, 100.0 * cpu / seconds, time.monotonic() - end, memory))
        if len(rows[name]) == 3:
            start, cpu, end, memory = map(statistics.median, zip(*rows[name]))
            print(f"{name:<32} {start:7.2f} {cpu:7.1f} {end:7.2f} {memory:11.0f}", flush=True)


def storm(listener, folder, seconds):
    print("\nstorm of wrenches: 3 processes, 10 kHz in all, every second one wrong")
    with simulation(scene="heavy_top", publish_rate=1000.0, record=folder / "storm.mcap") as node:
        before, memory = listener.figures(), node.memory()
        factors = []
        with (
            Process(BARE, "storm", 10_000 / 3, seconds) as a,
            Process(BARE, "storm", 10_000 / 3, seconds) as b,
            Process(BARE, "storm", 10_000 / 3, seconds) as c,
        ):
            end = time.monotonic() + 2.0 + seconds
            while time.monotonic() < end:
                factors.append(float(listener.figures()["real_time_factor"]))
            answers = [process.answer() for process in (a, b, c)]
        last, grown = listener.figures(), node.memory() - memory
        code = node.end()
    taken = {key: int(last[key]) - int(before[key]) for key in ("wrenches_accepted", "wrenches_refused")}
    sent = {key: sum(answer[key] for answer in answers) for key in ("sent", "wrong")}
    print(
        f"sent {sent['sent']}, {sent['wrong']} of them wrong; accepted "
        f"{taken['wrenches_accepted']}, refused {taken['wrenches_refused']}; not delivered "
        f"{sent['sent'] - sum(taken.values())}"
    )
    print(
        f"real-time factor {min(factors):.4f} to {max(factors):.4f}, lateness p99 "
        f"{float(last['lateness_p99_us']):.0f} us, memory {memory:.0f} MB and {grown:+.1f} MB, "
        f"recorder lost {last['recorder_lost']}, exit code {code}"
    )


def main():
    """Run all parts, or the named ones."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "parts",
        nargs="*",
        metavar="PART",
        help="real_time, kept, largest, bodies, round_trip, cost or storm (default: all)",
    )
    parser.add_argument("--long", action="store_true", help="60 and 30 s instead of 5 and 5 s")
    args = parser.parse_args()
    lengths = {
        real_time: (60.0, 5.0),
        kept: (60.0, 5.0),
        largest: (10.0, 4.0),
        bodies: (10.0, 4.0),
        round_trip: (2000, 200),
        cost: (30.0, 4.0),
        storm: (30.0, 5.0),
    }
    parts = {part.__name__: part for part in lengths}
    if unknown := set(args.parts) - set(parts):
        parser.error(f"unknown part {min(unknown)}; there are {', '.join(parts)}")
    print(f"load of the machine at the start: {os.getloadavg()[0]:.2f} on {os.cpu_count()} cores")
    listener = Listener()
    with tempfile.TemporaryDirectory() as folder:
        for name in args.parts or parts:
            long, short = lengths[parts[name]]
            parts[name](listener, Path(folder), long if args.long else short)


if __name__ == "__main__":
    main()
