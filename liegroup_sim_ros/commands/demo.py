# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim demo`: simulate in real time, apply a force, record and analyse.

The simulation node and the publisher of the force are separate processes in their own ROS domain,
limited to this machine. The demo ends both before it returns, also after an error.
"""

import math
import os
import random
import shlex
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from liegroup_core.errors import LieGroupSimError
from liegroup_sim_ros.signals import Signals

from .arguments import has_display

SCENE, BODY = "heavy_top", "top"
PUBLISH_RATE = 500.0  # Hz
PUSH = ("push", BODY, "--force", "0", "250", "0", "--duration", "0.4")  # N in body axes, s
PUSH_AT = 0.3  # start of the push, fraction of the run
SHORTEST = 4.0  # s: discovery of the push may take 2.5 s
STARTING = 240.0  # s, time limit of the start; the first start on a machine compiles
PUSHING = ENDING = 10.0  # s, time limits of the push and of the shutdown


class DemoError(LieGroupSimError):
    """The demo cannot continue; one line of text, exit code 2."""


def add_arguments(parser):
    """Arguments of the subcommand."""
    parser.description = (
        f"Simulate the scene {SCENE} in real time, apply a force from a second process, record "
        "everything and analyse the recording."
    )
    parser.add_argument(
        "--out",
        default="demo_out",
        metavar="DIR",
        help="folder for the recording and the HTML report; files of an earlier demo are "
        "overwritten (default: %(default)s)",
    )
    parser.add_argument(
        "--seconds", type=float, default=10.0, metavar="S", help="duration of the run in s (default: %(default)g)"
    )


def run(args):
    """Run the subcommand; returns the exit code. Raises DemoError."""
    if not (math.isfinite(args.seconds) and args.seconds >= SHORTEST):
        raise DemoError(f"--seconds must be at least {SHORTEST:g}")
    out = Path(args.out)
    log, page, figures, output = (out / name for name in ("demo.mcap", "demo.html", "demo.json", "sim_node.txt"))
    try:
        out.mkdir(parents=True, exist_ok=True)
        for path in (log, page, figures, output):
            path.unlink(missing_ok=True)
    except OSError as error:
        raise DemoError(f"{error.filename}: {error.strerror}") from None
    console = Console()
    with Signals() as signals:
        _simulate(args.seconds, log, output, console, signals.check)
    analysis = _analyse(log, page, figures)
    if not analysis.figures["pushes"]:
        raise DemoError("the applied wrench is not in the recording; see " + str(output))
    console.print(f"recording  {log}\nreport     {page}\nfigures    {figures}", highlight=False, soft_wrap=True)
    return 0


def _analyse(log, page, figures):
    """Analyse the recording, write the HTML report and the figures, print the table."""
    from liegroup_sim_ros.analysis import analyse
    from liegroup_sim_ros.analysis.document import document
    from liegroup_sim_ros.recording import read_recording
    from liegroup_sim_ros.report.files import write_text
    from liegroup_sim_ros.report.page import make_page, page_part
    from liegroup_sim_ros.report.terminal import print_table

    with Console(stderr=True).status("reading") as status:
        analysis = analyse(read_recording(log), tell=status.update)
    write_text(page, make_page([page_part(analysis)]))
    write_text(figures, document([analysis.figures]))
    print_table(analysis.figures, Console(file=sys.stdout))
    return analysis


def _simulate(seconds, log, output, console, check):
    """Run the node for some seconds of simulated time, with a force in between."""
    os.environ.update(ROS_DOMAIN_ID=str(random.randint(1, 100)), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    parameters = {"scene": SCENE, "publish_rate": PUBLISH_RATE, "record": log}
    if find_spec("viser") is not None and has_display():
        parameters["view"] = "true"
    arguments = [part for name, value in parameters.items() for part in ("-p", f"{name}:={value}")]
    console.print("$ sim_node --ros-args " + shlex.join(arguments), style="dim", highlight=False, soft_wrap=True)
    processes = []
    try:
        with open(output, "w", encoding="utf-8") as stream:
            node = _start("node.entry", ["--ros-args", *arguments], stream, processes)
            # The analysis needs additional kernels, which a second core compiles during the run.
            _start("analysis.compiled", [SCENE], subprocess.DEVNULL, processes)
            with console.status("starting (the first run of a kind of mechanism compiles for about 20 s)"):
                _wait_until(log.exists, STARTING, node, output, check)
            _watch(seconds, node, output, processes, console, check)
            node.send_signal(signal.SIGINT)
            try:
                code = node.wait(ENDING)
            except subprocess.TimeoutExpired:
                raise DemoError(f"sim_node did not end within {ENDING:g} s; see {output}") from None
            if code != 0:
                raise DemoError(f"sim_node ended with exit code {code}: {_last_line(output)}")
    finally:
        _end_all(processes)


def _watch(seconds, node, output, processes, console, check):
    """Show the node's diagnostics for some seconds; apply the force in between."""
    push, answered, elapsed = None, False, 0.0
    start = time.monotonic()

    def going_on():
        # On a loaded machine the publisher starts slowly, so the run waits for it.
        return elapsed < seconds or not answered and elapsed < seconds + PUSHING

    with (
        _diagnostics() as latest,
        Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.fields[status_text]}"),
            TimeElapsedColumn(),
            console=console,
        ) as progress,
    ):
        task = progress.add_task("simulating", total=seconds, status_text="")
        while going_on():
            check()
            if node.poll() is not None:
                raise DemoError(f"sim_node ended with exit code {node.returncode}: " + _last_line(output))
            if push is None and elapsed >= PUSH_AT * seconds:
                progress.console.print(
                    "$ liegroup_sim " + shlex.join(PUSH), style="dim", highlight=False, soft_wrap=True
                )
                push = _start("commands.main", PUSH, subprocess.PIPE, processes)
            if push is not None and push.poll() is not None and not answered:
                answered = True
                answer = push.communicate()[0].strip()
                if push.returncode != 0:
                    raise DemoError(f"the push failed: {answer}")
                progress.console.print(answer, highlight=False, soft_wrap=True)
            figures = latest(0.1)
            status_text = (
                "real-time factor {real_time_factor:.3f}, scheduling latency p99 {lateness_p99_us:.0f} us".format(
                    **figures
                )
                if figures
                else ""
            )
            elapsed = time.monotonic() - start
            progress.update(task, completed=elapsed, status_text=status_text)
    if not answered:
        raise DemoError(f"the push did not end within {seconds + PUSHING:g} s")


@contextmanager
def _diagnostics():
    """Function latest(seconds), which waits for this time and returns the last figures of /diagnostics."""
    try:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.executors import SingleThreadedExecutor
    except ImportError as error:
        raise DemoError(f"ROS 2 is needed for the demo: {error}") from None
    context = rclpy.Context()
    context.init()
    node = rclpy.create_node("liegroup_sim_demo", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    figures = {}

    def take(message):
        pairs = {pair.key: pair.value for status in message.status for pair in status.values}
        if {"real_time_factor", "lateness_p99_us"} <= set(pairs):
            figures.update((key, float(pairs[key])) for key in ("real_time_factor", "lateness_p99_us"))

    node.create_subscription(DiagnosticArray, "/diagnostics", take, 10)

    def latest(seconds):
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            executor.spin_once(timeout_sec=left)
        return figures

    try:
        yield latest
    finally:
        executor.shutdown()
        node.destroy_node()
        context.try_shutdown()


def _start(module, arguments, stream, processes):
    """Start a process of this package in its own session, so that it gets Ctrl-C only from the demo."""
    # -P: do not import from the working folder instead of the installed package.
    process = subprocess.Popen(
        [
            sys.executable,
            "-P",
            "-c",
            f"import sys; from liegroup_sim_ros.{module} import main; "
            f"sys.exit(main({'sys.argv[1:]' if module == 'main' else ''}))",
            *arguments,
        ],
        stdin=subprocess.DEVNULL,
        stdout=stream,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    processes.append(process)
    return process


def _wait_until(condition, seconds, node, output, check):
    end = time.monotonic() + seconds
    while not condition():
        check()
        if node.poll() is not None:
            raise DemoError(f"sim_node ended with exit code {node.returncode}: " + _last_line(output))
        if time.monotonic() > end:
            raise DemoError(f"sim_node was not ready within {seconds:g} s; see {output}")
        time.sleep(0.05)


def _last_line(output):
    lines = output.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    return lines[-1] if lines else "it printed nothing"


def _end_all(processes):
    """End running processes: SIGINT first, then SIGKILL."""
    for number, patience in ((signal.SIGINT, 5.0), (signal.SIGKILL, 5.0)):
        running = [process for process in processes if process.poll() is None]
        for process in running:
            os.killpg(process.pid, number)
        end = time.monotonic() + patience
        for process in running:
            try:
                process.wait(max(0.0, end - time.monotonic()))
            except subprocess.TimeoutExpired:
                pass
