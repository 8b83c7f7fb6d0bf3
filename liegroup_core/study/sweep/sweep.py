# SPDX-License-Identifier: Apache-2.0
"""Ensembles: runs of a scene with parameters sampled from ranges by a Latin hypercube.

    scene = load_scene("heavy_top")
    sweep = Sweep.of(scene, ["mass=10:20"], samples=100, steps=1000)
    for columns in sweep.run(range(100), workers=1):
        print(columns["bodies.top.mass"], columns["top.z"], columns["status"])

Run k depends only on the sweep and on k, not on other runs, workers or scheduling. A run that cannot
start or stops early gives a row with the reason as its status.
"""

import hashlib
import itertools
import math
import time
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from scipy.stats.qmc import LatinHypercube

from liegroup_core.compiling import source_digest
from liegroup_core.control import ControlError, set_up
from liegroup_core.errors import LieGroupSimError
from liegroup_core.joint_events import has_impacts
from liegroup_core.layout import make_layout
from liegroup_core.linear.sensitivities import outputs_of, sensitivities
from liegroup_core.observables.quantities import WRENCH
from liegroup_core.scene.assembly import assembled
from liegroup_core.scene.load import scene_as_written
from liegroup_core.scene.parameters import ParameterError, changed, parameters, range_of
from liegroup_core.simulation import Simulation
from liegroup_core.study.tasks import TasksError
from liegroup_core.study.tasks import run as run_tasks
from liegroup_core.study.trade.measure import listening

FORMAT = 2  # version of the description and of the columns
STATES = ("time", "states")  # recorded columns
CHECKS = 10  # default number of evaluations of energy and joints in a run
# CPU time of a batch in s: far above the cost of its distribution, and short enough that an
# interruption loses few runs. The number of batches is limited because each is a file.
PIECE, MOST_PIECES = 0.5, 1000
MOST_VALUES = 2_000_000  # in the results of a batch
MOST_DRAWS = 100_000_000  # sampled numbers, 0.8 GB
FIRST = 0.2  # CPU s of the first runs, which measure the cost of a run
SMALL = 5.0  # CPU s in total; for shorter sweeps, starting workers does not pay
OK, LARGEST = "ok", "largest."  # a status; before the names of columns with the largest magnitude in a run
VELOCITIES = {"angular_velocity": 0, "linear_velocity": 3}  # first component in a twist
PLACES = (["position"], ["rotation_vector"])
NEAR = 1e-9  # round-off of assembly: larger changes of a sampled pose are reported


@dataclass(frozen=True)
class Sweep:
    """Specification of an ensemble, with all data that a worker needs.

    text     : text of the scene file
    name     : name of the scene
    ranges   : tuple of Range
    samples  : number of runs
    seed     : seed of the Latin hypercube, an integer >= 0
    steps    : number of steps of each run
    every    : number of steps between two evaluations of energy and joints
    keep     : whether the states at these times are saved
    assemble : whether sampled poses and velocities are corrected to satisfy the joints
    reactions : whether the largest reactions of all joints are columns
    record   : names of columns of the Catalogue, or groups, that are saved beside the states
    gradient : names of outputs, as of linear.sensitivities, whose derivatives at the end are columns
    settings : ((name, value), ...), arguments of Simulation, including the step
    control  : () or (source, name) of a function that adds controllers to each simulation, see control.read_setup;
               source None: of a sweep that was read from a file, which cannot run
    sources  : digest of the sources, which must be the same on a worker
    """

    text: str
    name: str
    ranges: tuple
    samples: int
    seed: int
    steps: int
    every: int
    keep: bool
    assemble: bool
    reactions: bool
    record: tuple
    gradient: tuple
    settings: tuple
    control: tuple
    sources: str

    @classmethod
    def of(
        cls,
        scene,
        vary,
        samples,
        steps,
        seed=0,
        every=None,
        assemble=False,
        settings=None,
        reactions=False,
        record=(),
        gradient=(),
        control=(),
    ):
        """Sweep of a Scene with ranges as texts, see parameters.range_of; other arguments as above.

        every : None: a tenth of the run, and states are not saved
        gradient : names that stand for many are allowed
        raises ParameterError, SceneError, and ValueError for a configuration that does not suit the scene
        """
        for number, least, what in (
            (samples, 1, "samples"),
            (steps, 1, "steps"),
            (seed, 0, "the seed"),
            (every or 1, 1, "every"),
        ):
            if number < least:
                raise ParameterError(f"{what} must be at least {least}, got {number}")
        written = scene_as_written(scene.text, scene.source)
        ranges = tuple(range_of(written, text) for text in vary)
        if not ranges:
            raise ParameterError("no parameter varies: give --vary NAME=LOW:HIGH")
        paths = [entry.path for entry in ranges]
        for path in paths:
            if paths.count(path) > 1:
                raise ParameterError(f"--vary: {path} is given twice")
        if samples * len(ranges) > MOST_DRAWS:
            raise ParameterError(
                f"{samples} samples of {len(ranges)} parameters exceed {MOST_DRAWS:.0e} "
                "numbers: run several sweeps with different seeds"
            )
        # This compiles the kernels and checks the configuration.
        simulation = Simulation(scene, **(settings or {}))
        settings = simulation.arguments
        if control:
            if gradient:
                raise ParameterError("derivatives do not know controllers: give --gradient or --control, not both")
            set_up(simulation, *control)  # raises ControlError
        if reactions or record:
            simulation.layout.reactions.warm_up()
        if gradient:
            gradient = outputs_of(simulation, gradient)
        simulation.layout.catalogue.names(record)  # raises SceneError for an unknown name
        return cls(
            scene.text,
            scene.name,
            ranges,
            samples,
            seed,
            steps,
            every or max(1, math.ceil(steps / CHECKS)),
            bool(every),
            assemble,
            reactions,
            tuple(record),
            tuple(gradient),
            tuple(sorted(settings.items())),
            tuple(control),
            source_digest(),
        )

    @property
    def paths(self):
        """Paths of the parameters, which are also the names of their columns."""
        return tuple(entry.path for entry in self.ranges)

    @property
    def values(self):
        """Sampled values (samples, parameters), a Latin hypercube."""
        return _values(self.ranges, self.samples, self.seed)

    @property
    def derivatives(self):
        """Names of the columns of the derivatives: of one output by all parameters, then of the next."""
        return [f"d {output} / d {path}" for output in self.gradient for path in self.paths]

    def scene(self, k):
        """Scene of run k; its `text` is a scene file. Raises SceneError."""
        return self._scene_at(self.values[k])

    def _scene_at(self, values):
        scene = changed(_base(self.text, self.name, self.assemble), dict(zip(self.paths, values)))
        return assembled(scene, _velocities_in(self.paths))

    def _unlike(self, values, scene):
        """One-line message if assembly changed a sampled pose, else None."""
        found = parameters(scene) if self._places else {}
        for path, value in zip(self.paths, values):
            if path in self._places and abs(found[path] - value) > NEAR * max(1.0, abs(value)):
                return (
                    f"assembly changed {path} to {found[path]:.6g} from the sampled {value:.6g}: "
                    "set initial: fixed for this body, or sample a joint frame that determines its pose"
                )
        return None

    @cached_property
    def _places(self):
        return (
            {path for path in self.paths if path.split(".")[2:3] in PLACES}
            if _base(self.text, self.name, self.assemble).assemble
            else set()
        )

    def simulation(self, k):
        """Simulation of run k in its initial state. Raises the errors of Simulation."""
        return self._controlled(self.scene(k))

    def _controlled(self, scene):
        simulation = Simulation(scene, **dict(self.settings))
        if self.control:
            source, name = self.control
            if source is None:
                raise ControlError(f"a file of a sweep has no code: set `control` to read_setup('FILE.py:{name}')")
            set_up(simulation, source, name)
        return simulation

    @property
    def columns(self):
        """{name: "int", "float", "text" or "list"} of the results, see docs/how-to/sweep.md."""
        recorded, largest = ([*columns.names] for columns in self._looks)
        kept = [f"samples.{name}" for name in recorded] if self.keep else []
        scene = _base(self.text, self.name, False)
        largest = [f"{LARGEST}{name}" for name in largest]
        if self.reactions and has_impacts(scene):
            largest += _impulses(scene)
        floats = (*recorded, "energy_start", "energy_drift", *largest, *self.derivatives)
        return (
            {"run": "int"}
            | dict.fromkeys(self.paths, "float")
            | {"status": "text", "warning": "text"}
            | dict.fromkeys(floats, "float")
            | dict.fromkeys(kept, "list")
            | {"cpu_s": "float"}
        )

    @property
    def units(self):
        """{column: unit} of the columns with one."""
        recorded, largest = (dict(zip(columns.names, columns.units)) for columns in self._looks)
        found = recorded | {f"samples.{name}": unit for name, unit in recorded.items()}
        found |= {f"{LARGEST}{name}": unit for name, unit in largest.items()}
        impulses = dict(
            zip(_impulses(_base(self.text, self.name, False)), itertools.cycle(3 * ["N m s"] + 3 * ["N s"]))
        )
        found |= impulses | {"energy_start": "J", "energy_drift": "J", "cpu_s": "s"}
        return {name: unit for name, unit in found.items() if unit}

    @property
    def _looks(self):
        """(Columns that are saved, Columns whose largest magnitudes are saved)."""
        return _looks(self.text, self.name, self.record, self.reactions)

    def run(self, runs, scheduler=None, workers=None):
        """Run the runs with these numbers, in ascending order; yields {column: (k,) values} of finished batches.

        scheduler, workers : see tasks.run; None: a short sweep runs in this process
        raises TasksError
        """
        runs = np.asarray(runs, dtype=int)
        if not len(runs):
            return
        try:
            self.simulation(int(runs[0]))  # the cost must not include compiling
        except (LieGroupSimError, ValueError, ArithmeticError):
            pass
        first = simulate((self, int(runs[0]), self._given(runs[: _together(runs)])), FIRST)
        yield first
        rest = runs[len(first["run"]) :]
        costs = first["cpu_s"]
        cost = max(float(np.mean(costs[1:] if len(costs) > 1 else costs)), 1e-6)
        total = cost * len(rest)
        if scheduler is None and workers is None and total < SMALL:
            workers = 1
        most = round(max(PIECE, total / MOST_PIECES) / cost)
        most = max(1, min(most, MOST_VALUES // self._size))
        pieces = []
        while len(rest):
            count = min(most, _together(rest))
            pieces.append((self, int(rest[0]), self._given(rest[:count])))
            rest = rest[count:]
        if pieces:
            for _, columns in run_tasks(simulate, pieces, scheduler, workers):
                yield columns

    @property
    def _size(self):
        """Approximate number of values per run."""
        kinds = list(self.columns.values())
        return len(kinds) + kinds.count("list") * (2 + self.steps // self.every)

    def _given(self, runs):
        return self.values[runs[0] : runs[0] + len(runs)]


@lru_cache(maxsize=4)
def _velocities_in(paths):
    """[(body, component)] of the velocities among these paths; assembly keeps their sampled values."""
    steps = [path.split(".") for path in paths]
    return tuple(
        (step[1], VELOCITIES[step[2]] + int(step[3])) for step in steps if step[0] == "bodies" and step[2] in VELOCITIES
    )


def _together(runs):
    """Number of consecutive run numbers at the start."""
    breaks = np.flatnonzero(np.diff(runs) != 1)
    return int(breaks[0]) + 1 if len(breaks) else len(runs)


@lru_cache(maxsize=4)
def _values(ranges, samples, seed):
    shares = LatinHypercube(len(ranges), seed=np.random.default_rng(seed)).random(samples)
    values = np.column_stack([entry.at(u) for entry, u in zip(ranges, shares.T)])
    values.flags.writeable = False
    return values


@lru_cache(maxsize=4)
def _looks(text, name, record, reactions):
    """As Sweep._looks: functions of Samples, which are the same for all runs."""
    catalogue, largest = (
        make_layout(scene_as_written(text, name)).catalogue,
        ("reactions", "forces") if reactions else (),
    )
    return catalogue.columns((*STATES, *record)), catalogue.columns(("constraint_residual", *largest))


def _impulses(scene):
    """Names of the columns of the largest impulses of all joints."""
    return [f"{LARGEST}{joint.name}.impulse_{part}" for joint in scene.joints for part in WRENCH]


@lru_cache(maxsize=4)
def _base(text, name, assemble):
    scene = scene_as_written(text, name)
    return scene.remade(assemble=True) if assemble else scene


def simulate(work, limit=math.inf):
    """Results of a batch: (Sweep, number of the first run, parameters of the runs).

    limit : CPU time in s after which no further run starts
    returns {column: values}, see Sweep.columns
    raises TasksError if the sources on this worker differ from those of the sweep
    """
    sweep, first, values = work
    if sweep.sources != source_digest():
        raise TasksError("a worker has another version of liegroup_core: install the same version on all machines")
    rows, spent = [], 0.0
    for k, row in enumerate(values):
        rows.append({"run": first + k, **dict(zip(sweep.paths, row)), **_run(sweep, row)})
        spent += rows[-1]["cpu_s"]
        if spent > limit:
            break
    kinds = {"int": np.int64, "float": float}
    return {
        name: np.array([row.get(name, math.nan) for row in rows], dtype=kinds[kind])
        if kind in kinds
        else [row.get(name) for row in rows]
        for name, kind in sweep.columns.items()
    }


def _run(sweep, values):
    """One run as {column: value}, without the columns that it did not reach."""
    start = time.thread_time()
    looks, impulses, simulation, status = [], [], None, OK
    with listening() as said:
        try:
            scene = sweep._scene_at(values)
            said += filter(None, [sweep._unlike(values, scene)])
            simulation = sweep._controlled(scene)
            hits = sweep.reactions and has_impacts(scene)
            if hits:
                impulses.append(np.zeros((len(scene.joints), 6)))
                simulation.drain_impacts()  # from here on, impacts are recorded
            looks.append(_look(simulation, sweep))
            while simulation.steps < sweep.steps:
                simulation.advance(min(sweep.every, sweep.steps - simulation.steps))
                looks.append(_look(simulation, sweep))
                if hits:
                    impulses += (np.abs(impact.array) for impact in simulation.drain_impacts())
                    impulses = [np.max(impulses, axis=0)]  # NaN where one is undetermined
        except (LieGroupSimError, ValueError, ArithmeticError) as error:
            status = " ".join(str(error).split()) or type(error).__name__
            if looks and simulation.steps > looks[-1].steps:
                looks.append(_look(simulation, sweep))
    found = {"status": status, "warning": None}
    if looks:
        recorded, largest = sweep._looks
        energy = np.array([look.energy for look in looks])
        found |= {
            "warning": simulation.doubt or next(iter(said), None),
            "energy_start": energy[0],
            "energy_drift": np.abs(energy - energy[0]).max(),
        }
        most = np.abs([look.largest for look in looks]).max(axis=0)
        found |= {f"{LARGEST}{name}": number for name, number in zip(largest.names, most)}
        if impulses:
            found |= zip(_impulses(scene), impulses[0].ravel())
        states = np.array([look.recorded for look in looks])
        found |= zip(recorded.names, states[-1])
        if sweep.gradient and status == OK:
            try:
                found |= _gradient(sweep, scene)
            except LieGroupSimError as error:
                found["warning"] = found["warning"] or " ".join(f"no derivatives: {error}".split())
        if sweep.keep:
            found |= {f"samples.{name}": column for name, column in zip(recorded.names, states.T.copy())}
    return found | {"cpu_s": time.thread_time() - start}


def _gradient(sweep, scene):
    """{column: derivative} at the end of a run."""
    settings = dict(sweep.settings)
    end = sweep.steps * settings["step"]
    found = sensitivities(scene, sweep.paths, [end], sweep.gradient, **settings)
    return dict(zip(sweep.derivatives, found.derivatives[0].ravel()))


class _Look(NamedTuple):
    """What is kept of a state: number of steps, energy, and numbers of the two Columns of Sweep._looks."""

    steps: int
    energy: float
    recorded: np.ndarray
    largest: np.ndarray


def _look(simulation, sweep):
    sample = simulation.sample()
    if not math.isfinite(sample.energy):
        raise ArithmeticError(f"the energy is not finite at t = {sample.time:.9g} s")
    return _Look(sample.steps, sample.energy, *(columns.of(sample) for columns in sweep._looks))


def describe(sweep):
    """Sweep as JSON types; `described` is the inverse."""
    return {
        "format": FORMAT,
        "scene": sweep.name,
        "text": sweep.text,
        "vary": [str(entry) for entry in sweep.ranges],
        "samples": sweep.samples,
        "seed": sweep.seed,
        "steps": sweep.steps,
        "every": sweep.every,
        "keep": sweep.keep,
        "assemble": sweep.assemble,
        "reactions": sweep.reactions,
        "record": list(sweep.record),
        "gradient": list(sweep.gradient),
        "settings": dict(sweep.settings),
        # Files are not trusted, so no code is read from them.
        "control": sweep.control and [hashlib.sha256(str(sweep.control[0]).encode()).hexdigest(), sweep.control[1]],
        "sources": sweep.sources,
    }


def described(entries):
    """Sweep from the result of `describe`. Raises KeyError, ValueError."""
    scene = scene_as_written(entries["text"], entries["scene"])
    return Sweep(
        entries["text"],
        entries["scene"],
        tuple(range_of(scene, text) for text in entries["vary"]),
        entries["samples"],
        entries["seed"],
        entries["steps"],
        entries["every"],
        entries["keep"],
        entries["assemble"],
        entries.get("reactions", False),
        tuple(entries.get("record", ())),
        tuple(entries.get("gradient", ())),
        tuple(sorted(entries["settings"].items())),
        (None, entries["control"][1]) if entries.get("control") else (),
        entries["sources"],
    )
