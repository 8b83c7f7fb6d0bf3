# SPDX-License-Identifier: Apache-2.0
"""Random programs: a run depends on its commands alone, and not on what is read, restored or branched meanwhile."""

import contextlib
import copy
import zlib

import numpy as np
import pytest
from scene_files import text_of
from volume import some

from liegroup_core import Simulation, SimulationError, load_scene
from liegroup_core.layout import make_layout
from liegroup_core.methods.families import fitting_methods
from liegroup_core.scene.load import scene_from_text

SCENES = (
    *("lagrangian_top", "heavy_top", "four_bar", "slider_crank", "driven_arm", "flyball_governor", "hinge_chain"),
    *("stick_slip", "cable", "gripper", "door", "controlled", "kinked", "sampled", "touching"),
)
# A law with states, kinks and the time, on a mechanism with a stop.
CONTROLLED = text_of("controlled.yaml")
# The same without the stop, with friction that holds the hinge at times, a step and a pulse.
KINKED = CONTROLLED.replace(",\n   limits: {lower: -0.3, upper: 0.95, restitution: 0.5}", "").replace(
    "effort: a}",
    'effort: "a - 15*(1 if w > 0 else -1) - 4*max(q - 0.4, 0) + (2 if t - 0.1 > 0.0305 else 0)"'
    "}, {joint: hinge, effort: 5e5 if 0 < t - 0.07 <= 3e-7 else 0}",
)
# Sampled laws with periods that steps do not divide, delays and states, and a continuous one that reads their signals.
SENSORS = """sensors:
- {name: tracker, type: pose, body: tip, frame: {position: [0.1, 0, 0]}, position_noise: 0.01}
forces:"""
SAMPLED = (
    CONTROLLED.replace("name: controlled", "name: sampled")
    .replace("forces:", SENSORS)
    .replace("- {name: hold", text_of("sampled_law.yaml"))
)
# Contacts: a ball that slides on a plane and meets another one.
TOUCHING = text_of("touching.yaml")
OWN = {"touching": TOUCHING, "controlled": CONTROLLED, "kinked": KINKED, "sampled": SAMPLED}
ACCURACIES = ({"accuracy": 1e-5}, {"accuracy": 1e-3, "horizon": 5.0, "step": 0.1}, {"accuracy": 1e-9, "step": 2e-3})
SECONDS, COMMANDS = 0.25, 10
# Always: motions replace all of the scene (498); reading evaluates a motion that slides along a surface (5534),
# restores a second run with something at rest (6822), meets a part of a step that the second run cannot take (7402).
PAIRS = [498, 5534, 6822, 7402, *some(range(5000), 24)]


def program_of(simulation, rng):
    """[(time, what, arguments)] in s: commands that start and end at steps or within them, and checks."""
    layout, found = simulation.layout, []
    for _ in range(COMMANDS):
        time = round(rng.uniform(0.0, SECONDS), rng.choice([2, 9]))
        start = rng.choice([None, time, round(time + rng.uniform(0.0, 0.05), 9)])
        span = {"start": start, "duration": rng.choice([None, 1e-9, 1e-3, 0.01, 0.05])}
        body, values = str(rng.choice(layout.body_names)), (0.5 * rng.normal(size=6)).tolist()
        point = rng.choice([None, 1]) and values[:3]
        wrench = (
            (body, values),
            span | {"source": str(rng.choice(["a", "b"])), "axes": str(rng.choice(["body", "world"]))},
        )
        kinds = [("apply_wrench", wrench[0], wrench[1] | {"point": point})] * 3
        kinds += [("pull", (body, values[:3], 20.0, 1.0), span | {"source": "a", "point": point})]
        kinds += [("clear_wrenches", ("a",), {}), ("check", (), {})]
        for names, what, given in (
            (layout.unit_efforts, "apply_effort", (values[0],)),
            (layout.servos, "command_servo", (0.1 * values[0], values[1])),
        ):
            if names:
                kinds.append((what, (str(rng.choice(list(names))), *given), span))
        if layout.motions:
            times = np.cumsum(rng.uniform(0.01, 0.1, 2)).tolist()
            joint = str(rng.choice(list(layout.motions)))
            kinds.append(("command_motion", (joint, times, None, values[:2]), {"start": start}))
        if simulation.promise:
            kinds.append(("set_accuracy", (10.0 ** -rng.uniform(3.0, 8.0),), {}))
        found.append((time, *kinds[rng.integers(len(kinds))]))
    return [*sorted(found, key=lambda each: each[0]), (SECONDS, "check", (), {})]


class Player:
    """Plays a program; what it collects is compared.

    rng : of the reads, restores and branches between the commands; None: none
    """

    def __init__(self, fresh, rng=None):
        self._fresh, self._rng = fresh, rng
        self.simulation, self.found, self.applied, self.events = fresh(), [], [], []

    def play(self, program):
        simulation = self.simulation
        for time, what, given, options in program:
            self._read_up_to(time)
            simulation = self.simulation
            simulation.advance_to(time)
            if what == "check":
                self._check()
                continue
            try:
                getattr(simulation, what)(*given, **options)
            except ValueError as error:  # beyond a limit, for both
                self.found.append(str(error))
        self._drain()
        return self

    def _check(self):
        simulation = self.simulation
        sample = simulation.sample()
        arrays = sample.pose, sample.twist, sample.errors, sample.angles, simulation.reaction_array()
        numbers = simulation.time_ns, simulation.largest_error, simulation.substeps
        self.found.append((str(numbers), *(array.tobytes() for array in arrays)))
        self.found.append(simulation.snapshot())

    def _drain(self):
        self.applied += self.simulation.drain_applied()
        self.events += map(str, self.simulation.drain_events())

    def _read_up_to(self, time):
        rng = self._rng
        if rng is None:
            return
        for now in np.sort(rng.uniform(self.simulation.time, time, rng.integers(4))):
            simulation = self.simulation
            if rng.random() < 0.2:
                simulation.advance(int(now / simulation.step) - simulation.steps)
            else:
                simulation.advance_to(now)
            with contextlib.suppress(SimulationError):  # of a state beyond the last valid one
                self._read(simulation, now + 0.02 * rng.random())

    def _read(self, simulation, later):
        what = self._rng.integers(6)
        if what == 0:
            simulation.sample(later)
        elif what == 1:
            self._drain()
            self.simulation = self._fresh()
            self.simulation.restore(simulation.snapshot())
        elif what == 2:
            copy.deepcopy(simulation).advance_to(later)
        elif what == 3:
            assert simulation.snapshot() == simulation.snapshot()
        elif what == 4:
            simulation.reaction_array()
        else:
            simulation.state(), simulation.largest_error
        if self._rng.random() < 0.7:
            self.simulation.sample()


def cases():
    """[(scene, settings)] of all families."""
    found = []
    for name in SCENES:
        found += [(name, options) for options in ACCURACIES]
        found += [(name, {"method": m, "step": 2e-3}) for m in fitting_methods(make_layout(scene_of(name)))]
    return found


def scene_of(name):
    """Scene of SCENES."""
    return scene_from_text(OWN[name], name) if name in OWN else load_scene(name)


@pytest.mark.parametrize("part", range(4))
@pytest.mark.volume(2)
def test_programs_have_one_effect_whatever_is_read(part):
    """Bit-identical, snapshots too; if one cannot go on, the other cannot."""
    every = cases()
    for pair in PAIRS[part::4]:
        name, options = every[zlib.crc32(b"%d" % pair) % len(every)]
        scene = scene_of(name)

        def fresh(scene=scene, options=options):
            return Simulation(scene, quiet=True, **options)

        program = program_of(fresh(), np.random.default_rng(pair))
        players = [Player(fresh), Player(fresh, np.random.default_rng([pair, 1]))]
        ends = []
        for player in players:
            try:
                player.play(program)
                ends.append(False)
            except SimulationError:
                ends.append(True)
        one, other = players
        where = pair, name, options
        assert ends[0] == ends[1], where
        for k, (mine, theirs) in enumerate(zip(one.found, other.found)):
            assert mine == theirs, (*where, k)
        if not ends[0]:
            assert (one.applied, one.events) == (other.applied, other.events), where
