# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim run`: simulate as fast as possible, without ROS, to arrays or to a recording.

Exit code 1 if the integration had to stop, 130 after Ctrl-C. In both cases all computed samples are
written. Wrong input is refused before a file is opened.
"""

import logging
import math
import sys
import textwrap
import time
from collections import Counter
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from liegroup_core import Simulation, SimulationError
from liegroup_core.control import read_setup, set_up
from liegroup_core.errors import LieGroupSimError
from liegroup_core.forces.instants import LATEST
from liegroup_core.methods.table import METHODS
from liegroup_core.observables.quantities import GROUPS
from liegroup_core.settings import SETTINGS
from liegroup_core.simulation import default_steps
from liegroup_sim_ros.messages.events import slips
from liegroup_sim_ros.numbers import counted
from liegroup_sim_ros.recording.attachments import steps_per_sample
from liegroup_sim_ros.recording.errors import FileLostError
from liegroup_sim_ros.recording.write_run import ArrayFile, LogFile
from liegroup_sim_ros.recording.write_tables import TableFile, torque_columns
from liegroup_sim_ros.signals import Signals

from .robot_options import add_robot_options, robot_scene
from .setting_options import add_settings, given

log = logging.getLogger("liegroup_core")

EXIT_STOPPED = EXIT_LOST = 1
REDRAW = 0.1  # s between two updates
DENSEST = 1000.0  # samples in a second of the motion, if --every is not given
HIGHEST_RATE = 1e9  # samples in a second: stamps are whole ns
MOST_SAMPLES = 10**8
NOTE = 160  # maximum length of a printed note of the scene


class RunError(LieGroupSimError):
    """The run is not possible; one line of text, exit code 2."""


def add_arguments(parser):
    """Arguments of the subcommand."""
    parser.description = (
        "Simulate a scene as fast as possible and write the trajectory to a file: arrays "
        "(*.npz), a table (*.csv) or a recording (*.mcap) for `liegroup_sim analyze` and other tools."
    )
    parser.add_argument("scene", metavar="SCENE", help="path of a scene or robot file, or name of an example scene")
    parser.add_argument(
        "--duration",
        type=float,
        metavar="S",
        help="simulated time in s: a multiple of the step, or any with --rate or --times (default: their last one)",
    )
    parser.add_argument("--out", metavar="FILE", help="output file (*.npz, *.csv or *.mcap); it must not exist")
    parser.add_argument(
        "--every",
        type=int,
        metavar="STEPS",
        help="steps between samples; the last state is always included (default: 1, if a second then has 1000 at most)",
    )
    parser.add_argument(
        "--rate", type=float, metavar="HZ", help="samples in a second instead of --every, also between steps"
    )
    parser.add_argument(
        "--times",
        metavar="FILE",
        help="text file of the times of the samples in s, one in a line, after # a comment, at least 1 ns apart; "
        "the start is always written",
    )
    parser.add_argument(
        "--no-estimate",
        dest="estimate",
        action="store_false",
        help="with a method: do not estimate the error, at about half of the cost",
    )
    parser.add_argument(
        "--reactions", action="store_true", help="also write the wrench of every joint on its child (nan: undetermined)"
    )
    parser.add_argument(
        "--columns",
        nargs="+",
        metavar="NAME",
        help=f"what a table or arrays have beside the time: {', '.join(GROUPS)}, or single ones, such as BODY.x, "
        "JOINT.position, FORCE.effort, SENSOR.0 (default: states, joints, energy, constraint_residual, errors)",
    )
    add_control(parser)
    parser.add_argument(
        "--torques",
        metavar="FILE",
        help="table (*.csv) of the efforts that the motions of driven joints require; it must not exist",
    )
    add_settings(parser)
    add_robot_options(parser)


def add_control(parser):
    """Argument for controllers."""
    parser.add_argument(
        "--control",
        metavar="FILE.py:NAME",
        help="function that is called with each simulation at its start and adds controllers, see Simulation.control",
    )


def given_settings(args):
    """Arguments of Simulation from those of a command line. Raises RunError."""
    settings = given(args)
    if "method" in settings:
        for name in {"accuracy", "horizon"} & settings.keys():
            raise RunError(f"--{name} cannot be combined with --method: remove one of them")
    elif "step" not in settings and args.duration is not None:
        whole_steps(args.duration, args.duration)  # raises RunError for an invalid duration
        settings["step"] = dividing_step(args.duration, settings.get("horizon", SETTINGS["horizon"].default))
    return settings


def dividing_step(duration, horizon):
    """Step in s for an accuracy that divides a duration."""
    usual = default_steps(horizon)
    return next((step for step in usual if divides(step, duration)), duration / math.ceil(duration / usual[0]))


def run(args):
    """Run the subcommand; returns the exit code. Raises SceneError, RunError, OutputError."""
    try:
        return _run(args)
    except FileLostError as error:
        print(f"liegroup_sim: {error}", file=sys.stderr)
        return EXIT_LOST


def _run(args):
    settings = given_settings(args)
    if args.out is None and args.torques is None:
        raise RunError("give --out FILE or --torques FILE: nothing would be written")
    kind = None
    if args.out is not None:
        kind = {".npz": ArrayFile, ".csv": TableFile, ".mcap": LogFile}.get(Path(args.out).suffix)
        if kind is None:
            raise RunError(f"{args.out}: the name must end in .npz, .csv or .mcap")
    if args.torques is not None and Path(args.torques).suffix != ".csv":
        raise RunError(f"{args.torques}: the name must end in .csv")
    if args.columns and args.reactions:
        raise RunError("--columns cannot be combined with --reactions: name reactions and forces among the columns")
    if args.every is not None and args.every < 1:
        raise RunError(f"--every must be at least 1, got {args.every}")
    asked = sample_times(args)
    scene = robot_scene(args.scene, args)
    console = Console(stderr=True)
    for note in scene.differences:
        short = textwrap.shorten(note, NOTE, placeholder=" ... (liegroup_sim describe has all)")
        console.print(f"{scene.name}: {short}", markup=False, highlight=False)
    try:
        with console.status("starting (the first run of a kind of mechanism compiles for about 20 s)"):
            simulation = Simulation(scene, **settings, estimate=args.estimate)
            if args.control:
                set_up(simulation, *read_setup(args.control), args.control.rpartition(":")[0])
    except ValueError as error:  # includes SceneError
        raise RunError(str(error)) from None
    if args.reactions or args.torques or args.columns:
        simulation.layout.reactions.warm_up()
    step = simulation.step
    every = args.every or max(1, math.ceil(1.0 / (DENSEST * step) - 1e-9))
    if asked is None:
        end, steps = None, whole_steps(args.duration, step)
        count = -(-steps // every)
        due = (simulation.instant_inside(min(k * every, steps), 0) for k in range(1, count + 1))
    else:
        count, times, end = asked
        due = (simulation.instant_of(round(time * 1e9)) for time in times)
        steps, every = (
            simulation.instant_of(round(end * 1e9)).step,
            None if args.rate is None else steps_per_sample(args.rate, step),
        )
    samples = 1 + count
    started = time.monotonic()
    stopped, code, slipped = None, 0, set()
    with ExitStack() as stack:
        signals = stack.enter_context(Signals())
        files = []
        if args.torques:
            columns = torque_columns(simulation, args.torques)
            files.append(stack.enter_context(TableFile(args.torques, simulation, columns=columns)))
        if kind:
            file = kind(args.out, simulation, every, samples, args.reactions, args.columns)
            files.append(stack.enter_context(file))

        def write():
            sample = simulation.sample()
            for file in files:
                file.sample(sample)
            for joint in sample.slipping:
                if joint not in slipped:
                    slipped.add(joint)
                    log.warning(slips(sample.contacts[joint], joint, sample.time))

        write()
        try:
            _simulate(simulation, steps, due, write, console, signals)
        except SimulationError as error:
            stopped, code = str(error), EXIT_STOPPED
        except KeyboardInterrupt:
            stopped, code = f"interrupted at t = {simulation.time:.9g} s", 130
        if stopped and simulation.steps > files[0].last_step:
            write()
        wall = time.monotonic() - started
        for file in files:
            file.finish(simulation, stopped, code == EXIT_STOPPED, wall)
    names = " and ".join(name for name in (args.out, args.torques) if name)
    if stopped:
        print(f"liegroup_sim: {stopped}; the trajectory up to there is in {names}", file=sys.stderr)
    else:
        print(
            f"{names}: {simulation.time if end is None else end:.9g} s in {counted(steps, 'step')}, "
            f"{counted(files[0].count, 'sample')}, {wall:.3g} s of wall time"
            f"{_events_of(simulation)}{_error_of(simulation)}"
        )
    return code


def _events_of(simulation):
    """Text with the numbers of events at joints with stops or friction, and of contacts."""
    contacts, found = simulation.layout.touching.names, ""
    if simulation.layout.switches:
        found = f", {counted(simulation.event_count, 'event')} at joints"
    if not contacts:
        return found
    press = int(np.isfinite(simulation.sample().touching[:, 0]).sum())
    if not METHODS[simulation.method].controlled:
        return f"{found}, events of contacts unknown with fixed steps, {press} press at the end"
    kinds = Counter(event.kind for event in simulation.drain_events() if event.joint in contacts)
    contact = "contact" if len(contacts) == 1 else f"{len(contacts)} contacts"
    named = (("touch", "touch", "touches"), ("leave", "leaving", "leavings"), ("slip", "slip", "slips"))
    counts = (f"{kinds[kind]} {one if kinds[kind] == 1 else many}" for kind, one, many in named)
    return f"{found}, {', '.join(counts)} of {contact}, {press} press at the end"


def _error_of(simulation):
    """Text with the estimated error at the end, or the time of the first estimate."""
    errors = simulation.sample().errors
    if errors is None:
        return ""
    if np.isnan(errors).any():
        return f"; the error is not estimated before t = {simulation.estimated_from:.9g} s"
    position, attitude = errors[:, :2].max(axis=0)
    return f", estimated error at the end {position:.2g} m, {attitude:.2g} rad"


def sample_times(args):
    """(number, times in s, last time) of the samples after the start by --rate or --times, or None. Raises RunError."""
    if sum(each is not None for each in (args.every, args.rate, args.times)) > 1:
        raise RunError("give one of --every, --rate and --times")
    if args.times is not None:
        found = times_in(args.times)
        if args.duration is not None and args.duration < found[-1]:
            raise RunError(f"{args.times}: its last time {found[-1]:.9g} s is after the --duration {args.duration:g} s")
        if args.duration is not None and args.duration > found[-1]:
            found.append(args.duration)
        return len(found), found, found[-1]
    if args.duration is None:
        raise RunError("give --duration S")
    if args.rate is None:
        return None
    if not (math.isfinite(args.rate) and 0.0 < args.rate <= HIGHEST_RATE):
        raise RunError(f"--rate must be a positive number of samples in a second up to {HIGHEST_RATE:g}")
    if not 0.0 < args.duration <= LATEST:
        raise RunError(f"--duration must be a positive number of seconds, {LATEST:g} at most, got {args.duration:g}")
    count = math.ceil(args.duration * args.rate - 1e-6)
    if count > MOST_SAMPLES:
        raise RunError(
            f"--rate {args.rate:g} makes {count:.3g} samples: give a smaller one, {MOST_SAMPLES:.0e} at most"
        )
    times = (k / args.rate if k < count else args.duration for k in range(1, count + 1))
    return count, times, args.duration


def times_in(path):
    """Times in s of a text file, positive and increasing by 1 ns at least. Raises RunError."""
    try:
        lines = Path(path).read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise RunError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
    found = []
    for number, line in enumerate(lines, 1):
        line = line.partition("#")[0].strip()
        if not line:
            continue
        try:
            at = float(line)
        except ValueError:
            raise RunError(f"{path}, line {number}: expected a time in s, got {line!r:.60}") from None
        # Rounding of the decimals may take a hundredth of a ns at late times.
        if not (0.0 <= at <= LATEST and (not found or at >= found[-1] + 0.99e-9)):
            raise RunError(
                f"{path}, line {number}: times must be from 0 to {LATEST:g} s and increase by at least 1 ns, got {line}"
            )
        found.append(at)
    if found[:1] == [0.0]:
        del found[0]  # the start is always written
    if not found:
        raise RunError(f"{path}: contains no time after the start")
    return found


def _simulate(simulation, steps, due, write, console, signals):
    """Advance to the Instants of all samples, and call `write` at each."""
    with Progress(
        TextColumn("simulating"),
        BarColumn(),
        TextColumn("{task.fields[status_text]}"),
        TimeRemainingColumn(),
        console=console,
    ) as progress:
        task = progress.add_task("", total=steps, status_text="")
        drawn = 0.0
        for instant in due:
            while True:
                simulation.reach(instant, lambda: signals.received or time.monotonic() > drawn + REDRAW)
                signals.check()
                if time.monotonic() > drawn + REDRAW:
                    drawn = time.monotonic()
                    progress.update(task, completed=simulation.steps, status_text=f"{simulation.time:.3f} s")
                if simulation.now == instant:
                    break
            write()
        progress.update(task, completed=steps, status_text=f"{simulation.time:.3f} s")


def divides(step, duration):
    """True if a duration is a whole number of steps."""
    try:
        return whole_steps(duration, step) > 0
    except RunError:
        return False


def whole_steps(duration, step, name="--duration"):
    """Number of steps of a duration. Raises RunError."""
    if not (math.isfinite(duration) and duration > 0.0):
        raise RunError(f"{name} must be a positive number of seconds, got {duration:g}")
    steps = round(duration / step)
    # This tolerance is far above round-off and far below any relevant difference.
    if steps < 1 or abs(duration / step - steps) > 1e-6 * steps:
        nearest = max(1, steps) * step
        raise RunError(
            f"{name} {duration:g} s is {duration / step:.6g} steps of {step:g} s: it must "
            f"be a whole number of steps, such as {nearest:.9g}"
        )
    return steps
