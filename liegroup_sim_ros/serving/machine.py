# SPDX-License-Identifier: Apache-2.0
"""A machine beside a running simulation: how well, and how far ahead, the scene predicts it.

Stamps of the machine are compared with the wall time at which its messages arrive: clocks that differ by less than
APART count as one, others as constantly apart. Commands act when they arrive here.
"""

import contextlib
import logging
import math
import re
import threading
import time
from collections import deque
from dataclasses import replace

import numpy as np

from liegroup_core.errors import LieGroupSimError
from liegroup_core.identification.log import MOTION, Given, Log, Measured
from liegroup_core.identification.runs import Runs
from liegroup_core.identification.shadow import Shadow
from liegroup_core.scene.yaml_text import read_yaml
from liegroup_sim_ros.logs.bag import BagError
from liegroup_sim_ros.logs.live import LiveBag
from liegroup_sim_ros.logs.load import APART, channels_of, load_log, outputs_of
from liegroup_sim_ros.logs.map import Map
from liegroup_sim_ros.logs.suggest import suggest
from liegroup_sim_ros.messages import machine as messages

log = logging.getLogger("liegroup_core")

PERIOD = 0.25  # s of wall time between two comparisons, at least
FIRST = 6.0  # s of messages, as long as their rate is not known
SILENT = 2.0  # s without a message
# Standard deviations by which a prediction is off for more than chance: with ten intervals of ten outputs four times a
# second, a right model with normal noise exceeds it less than once a week.
SURE = 6.0
PATIENCE = 1.0  # s for the end of a comparison
NONE = "no message yet"
AGAIN = 0.5  # of a bound, below which predictions are right again
KEPT_NS = 30 * 10**9  # ns of wall time for which it is known what acted


class RealMachine(threading.Thread):
    """Comparison of a scene with the last messages of a machine; a thread of its own.

    scene, layout : Scene, and its Layout
    given  : Map; None: what the topics of the messages are in the scene is found by their names
    values : parameters machine_tolerance and machine_ahead, read at every comparison
    decode : as of LiveBag
    Raises SceneError for a map that does not fit the scene.

    arrived : wall time in ns at which the first command since the last sample arrived; 0: none
    """

    def __init__(self, scene, layout, given, values, decode):
        super().__init__(name="machine", daemon=True)
        self._scene, self._layout, self._given, self._values = scene, layout, given, values
        self._is_found, self._known = given is None, set()
        self._bag, self._shadow, self._seconds = LiveBag(decode), Shadow(scene), FIRST
        self._turns = {body.name: body.pose[:3, :3] for body in scene.bodies}
        self._lock, self._ending = threading.Lock(), threading.Event()
        self._acts, self._present, self._news, self._said = deque(), (None, time.time_ns()), [], set()
        self._origin, self._seen, self.arrived = None, 0, 0
        self._figures = {"machine_note": NONE}
        self._departs = False
        self._warm_up()

    def _warm_up(self):
        """Compile before the simulation runs, and check the names of the map."""
        given, times = self._given, np.arange(20) * 0.05
        wanted = [] if given is None else [outputs_of(each.output, self._scene) for each in given.measurements]
        inputs = [] if given is None else [channels_of(each.input, self._scene) for each in given.inputs]
        names = [name for group in wanted for name in group]
        names = names or [f"{name}.position" for name in self._layout.coordinates.names] or ["bodies"]
        names = tuple(self._layout.catalogue.names(names, "output"))
        zeros = np.zeros((len(times), len(names)))
        acting = [Given(name, times, zeros[:, 0]) for group in inputs for name in group if not name.endswith(MOTION)]
        rest = Log(tuple(acting), (Measured("", times, names, zeros, np.ones(len(names)), 0.0),))
        Runs(self._scene, rest)  # raises SceneError for unknown names
        with contextlib.suppress(LieGroupSimError, ValueError):  # the scene may not be able to rest there
            Shadow(self._scene).horizons(rest)

    # From other threads:

    def take(self, topic, kind, payload):
        """Add a message of the machine."""
        self._bag.take(topic, kind, time.time_ns(), payload)

    def watch(self, _, sample):
        """Note what acts in a Sample of the simulation, since a command arrived or else since the Sample before."""
        (before, since), now = self._present, time.time_ns()
        self._present, start, self.arrived = (sample.acting, now), self.arrived or since, 0
        if before is None or not before.is_same(sample.acting):
            with self._lock:
                self._acts.append((start, now, sample.time, sample.acting))
                while len(self._acts) > 1 and self._acts[1][0] < now - KEPT_NS:
                    self._acts.popleft()

    def news(self):
        """[(message or None, text of an event or "")] since the last call."""
        with self._lock:
            found, self._news = self._news, []
        return found

    @property
    def figures(self):
        """{name: number or text} for the diagnostics."""
        return self._figures

    def stop(self):
        """End the thread; it may still finish a comparison."""
        self._ending.set()
        if self.is_alive():
            self.join(PATIENCE)

    # In its thread:

    def run(self):
        """Compare until `stop`."""
        pause, before = PERIOD, ""
        while not self._ending.wait(pause):
            began = time.monotonic()
            try:
                note = self._compare()
            except LieGroupSimError as error:
                note = str(error)
            except Exception as error:  # of a machine, any number may come
                note = f"{type(error).__name__}: {error}"
            if note and note == before != NONE:  # not only while the first messages arrive
                self._say(note)
            before = note
            if note:
                self._figures = {"machine_note": note}
            pause = max(PERIOD, time.monotonic() - began)  # at most half of a core

    def _say(self, note):
        """Log a note, once whatever its numbers."""
        key = re.sub(r"[-+.e\d]+", "", note)
        if key not in self._said:
            self._said.add(key)
            log.warning("machine: %s", note)

    def _compare(self):
        """Compare the scene with the last messages; returns why it cannot, or ""."""
        if self._bag.update(self._seconds):
            self._shadow, self._origin = Shadow(self._scene), None
            self._say("its stamps went back: the comparison starts again")
        newest, known = self._bag.newest, set(self._bag.topics)
        if time.time_ns() - newest > SILENT * 1e9:
            return f"no message for {(time.time_ns() - newest) * 1e-9:.0f} s" if newest else NONE
        if newest == self._seen:
            return ""
        self._seen = newest
        if self._is_found and known != self._known:
            self._given = self._suggested()
            self._known = known
        first = next(each.topic for each in (*self._given.inputs, *self._given.measurements))
        late = self._bag.late(first, APART)
        if self._origin is None:  # times of the log are those of the simulation, in which laws are given
            self._origin = newest - late - round((self._acts[-1][2] if self._acts else 0.0) * 1e9)
        found = load_log(self._bag, self._given, self._scene, self._turns, self._origin)
        for note in found.notes:
            self._say(note)
        self._seconds = self._shadow.seconds(found)
        horizons = self._shadow.horizons(replace(found, acting=self._acting(late)))
        if horizons:
            self._judge(horizons, (time.time_ns() - newest) * 1e-9)
        return ""

    def _suggested(self):
        """Map of the topics by their names, with the motions of driven joints and no other inputs. Raises BagError."""
        text, notes = suggest(self._bag, self._scene, self._layout)
        root = read_yaml(text, "suggested map").value
        if not root["measurements"]:
            raise BagError(f"no topic fits the names of {self._scene.name}: give a map; {'; '.join(notes[:1])}")
        root["inputs"] = [each for each in root["inputs"] if each["input"].endswith(MOTION)]
        return Map(**root)

    def _acting(self, late):
        """((time in s, Acting)) of the simulation, in times of the log; late: ns of the clock of the log."""
        with self._lock:
            acts, last, rows = list(self._acts), -math.inf, []
        for start, now, at, acting in acts:
            last = max(last, (start - late - self._origin) * 1e-9)
            motions = acting.motions.copy()
            motions[:, 0] += (now - late - self._origin) * 1e-9 - at
            rows.append((last, acting._replace(motions=motions)))
        return tuple(rows)

    def _judge(self, horizons, age):
        """Publish how far predictions are off, and whether that begins or ends to be too much."""
        tolerance, ahead = self._values.machine_tolerance, self._values.machine_ahead
        judged = [each for each in horizons if each.unit in ("rad", "m")] or horizons
        ratios = [each.error / np.maximum(tolerance, SURE * each.expected) for each in horizons]
        off = [(r[k], k, of) for r, of in zip(ratios, horizons) if of in judged for k in range(len(r))]
        off = [each for each in off if each[2].ahead[each[1]] <= ahead + 1e-9]
        if not off:
            return
        ratio, k, worst = max(off, key=lambda each: each[0])
        error, at, explained = (float(of[k]) for of in (worst.error, worst.ahead, worst.expected))
        found = f"{error:.2g} {worst.unit} is the error of {worst.name} predicted {at:g} s ahead"
        found, text = f"{found}, where {explained:.2g} {worst.unit} is explained", ""
        if ratio > 1.0 and not self._departs or ratio < AGAIN and self._departs:
            self._departs = not self._departs
            text = f"{found}: the machine {'departs from' if self._departs else 'is again as predicted by'} the scene"
        self._figures = {
            "machine_horizon_s": min(each.within(tolerance) for each in judged),
            "machine_tolerance": tolerance,
            "machine_output": worst.name,
            "machine_error": error,
            "machine_error_ahead_s": at,
            "machine_ratio": float(ratio),
            "machine_age_s": age,
            "machine_departs": found if self._departs else "",
            "machine_note": "",
        }
        ratios = [r if of in judged else np.full(len(r), np.nan) for r, of in zip(ratios, horizons)]
        with self._lock:
            self._news.append((messages.encode(horizons, ratios, tolerance), text))
