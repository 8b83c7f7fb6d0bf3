# SPDX-License-Identifier: Apache-2.0
"""Files of an offline run: arrays for NumPy, or a recording in the format of the node.

Tables are in write_tables.py. The classes have sample(sample), finish(simulation, stopped, failed,
wall_seconds), `count` and `last_step`. The `with` block closes the file. `stopped` is the reason why
the run ended early, or None. Existing files are never overwritten.
"""

import json
from functools import partial
from itertools import groupby
from operator import attrgetter, itemgetter
from pathlib import Path

import numpy as np

from liegroup_core.forces.commands import MOTION, TARGET
from liegroup_core.joint_events import has_impacts
from liegroup_core.joints.motion import FROM_SCENE
from liegroup_sim_ros.messages import commands, estimates, events, inputs, law_states, schemas, topics
from liegroup_sim_ros.messages import samples as sample_messages
from liegroup_sim_ros.messages.codecs import LogCodec
from liegroup_sim_ros.messages.joint_modes import JointReports, has_reports
from liegroup_sim_ros.numbers import counted

from . import attachments
from .checkpoints import Checkpoints
from .errors import FileLostError, OutputError, RecorderError
from .write import Recorder
from .write_tables import close_new, has_estimate, joint_names, new_file

NODE = "/sim_node"  # topics have the same names as in a run of the node
WORLD_FRAME = "world"


class ArrayFile:
    """NumPy file *.npz of k samples of n bodies; read it with numpy.load(path).

    time (k,) s, steps (k,), bodies (n,) names, poses (k, n, 4, 4) body -> world, m,
    twists (k, n, 6) (omega, v) rad/s and m/s in body axes, energy (k,) J,
    residual (k,) largest joint residual, m or rad; errors (k, n, 4) estimated errors, m, rad, m/s
    and rad/s, if the simulation has an estimate; on request joints (j,) names and reactions
    (k, j, 6), see Sample.reactions, forces (f,) names and efforts (k, f), see Sample.force_efforts,
    driven (d,) names and drive_efforts (k, d), with rigid stops impact_time (i,) s and impulses (i, j, 6)
    of all joints, see Engine.drain_impacts; sensors/NAME (k, m) of each sensor of the scene, see
    Sample.sensors; scene and settings: texts, YAML and JSON. With chosen columns only time, bodies, the columns by
    their names, each (k,), columns (c,) names, units (c,) texts, scene and settings.
    """

    def __init__(self, path, simulation, every, samples, reactions=False, columns=None):
        self.count, self.last_step = 0, -1
        self._path, self._every = Path(path), every
        self._names, self._simulation = {}, simulation
        self._impacts = [] if reactions and has_impacts(simulation.scene) else None
        if self._impacts is not None:
            simulation.drain_impacts()  # the simulation collects impacts from here on
        layout = simulation.layout
        if reactions:
            names = (
                ("joints", joint_names(simulation)),
                ("forces", [*layout.joint_forces]),
                ("driven", [*layout.motions]),
            )
            self._names = {key: np.array(some) for key, some in names if some or key != "driven"}
        catalogue, sample, n = layout.catalogue, simulation.sample(), len(layout.body_names)
        self._columns = catalogue.columns(columns) if columns else None
        if columns:
            self._of = {"time": lambda sample: sample.time, "columns": self._columns.of}
        else:
            self._of = arrays(simulation, reactions)
        first = {key: np.asarray(of(sample)) for key, of in self._of.items()}
        try:
            self._arrays = {key: np.empty((samples, *value.shape), value.dtype) for key, value in first.items()}
        except MemoryError:
            raise OutputError(
                f"{path}: {samples} samples of {counted(n, 'body')} do not fit into memory; "
                "take fewer with --every, or write *.mcap"
            ) from None
        self._stream = new_file(path, "xb")

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        close_new(self._stream, self._path, exception[0] is not None)

    def sample(self, sample):
        """Append a sample."""
        for key, of in self._of.items():
            self._arrays[key][self.count] = of(sample)
        if self._impacts is not None:
            self._impacts += self._simulation.drain_impacts()
        self.count, self.last_step = self.count + 1, sample.steps

    def finish(self, simulation, stopped, failed, wall_seconds):
        """Write everything. Raises OutputError."""
        settings = attachments.settings(simulation, self._every)
        settings |= {"stopped": stopped, "failed": failed, "wall_seconds": wall_seconds}
        if self._impacts is not None:
            impulses = [impact.array for impact in self._impacts]
            self._names["impact_time"] = np.array([impact.time for impact in self._impacts])
            self._names["impulses"] = np.reshape(impulses, (-1, len(self._names["joints"]), 6))
        if self._columns is not None:
            self._arrays |= zip(self._columns.names, self._arrays.pop("columns").T)
            self._names |= {"columns": np.array(self._columns.names), "units": np.array(self._columns.units)}
        try:
            np.savez(
                self._stream,
                **{name: array[: self.count] for name, array in self._arrays.items()},
                bodies=np.array(simulation.layout.body_names),
                **self._names,
                scene=np.array(simulation.scene.text),
                settings=np.array(json.dumps(settings, indent=1)),
            )
            self._stream.flush()
        except OSError as error:
            raise OutputError(f"{self._path}: cannot be written: {error.strerror}") from None


def arrays(simulation, reactions):
    """{array of *.npz: function Sample -> its row}."""
    found = {
        "time": lambda sample: sample.time,
        "steps": lambda sample: sample.steps,
        "poses": lambda sample: sample.pose_matrices,
        "twists": lambda sample: sample.twist,
        "energy": lambda sample: sample.energy,
        "residual": lambda sample: sample.constraint_residual,
    }
    if has_estimate(simulation):
        found["errors"] = lambda sample: sample.errors
    if reactions:
        found["reactions"] = lambda sample: sample.reaction_array
        found["efforts"] = lambda sample: list(sample.force_efforts.values())
        if simulation.layout.motions:
            found["drive_efforts"] = lambda sample: list(sample.drive_efforts.values())
    for each in simulation.scene.sensors:
        found[f"sensors/{each.name}"] = lambda sample, name=each.name: sample.sensors[name]
    return found


class LogFile:
    """Recording *.mcap in the node's format, without clock and diagnostics (docs/reference/node.md)."""

    def __init__(self, path, simulation, every, _samples, reactions=False, columns=None):
        if columns:
            raise OutputError(f"{path}: a recording has topics, not columns: write *.csv or *.npz, or omit --columns")
        self.count, self.last_step = 0, -1
        self._simulation, self._told = simulation, set()  # events that are recorded once
        self._stamp = simulation.time_ns  # of the last sample
        self._values = simulation.inputs.targets_by_joint | simulation.inputs.motions_by_joint
        simulation.drain_applied()  # what was commanded before is in the initial state
        try:
            on_request = sample_messages.reactions(simulation.layout, WORLD_FRAME) if reactions else []
        except ValueError as error:
            raise OutputError(f"{path}: --reactions: {error}; *.npz has no topics") from None
        layout = simulation.layout
        if layout.motions or layout.servos:
            on_request += sample_messages.joint_states(layout, WORLD_FRAME)
        on_request += sample_messages.sensors(layout, WORLD_FRAME)
        impulses = []
        if reactions and has_impacts(layout.scene):
            impulses = sample_messages.impulses(layout)
            simulation.drain_impacts()  # the simulation collects impacts from here on
        if layout.motions or layout.scene.sensors:
            layout.reactions.warm_up()  # for the efforts of driven joints, and force-torque sensors
        bodies = layout.body_names
        own = topics.own_by_default(bodies)
        motion, self._encode = sample_messages.motion(bodies, own, WORLD_FRAME)
        optional = {
            "errors": (topics.ERRORS, has_estimate(simulation)),
            "laws": (topics.LAWS, layout.states),
            "joint_modes": (topics.JOINT_MODES, layout.switches),
            "servo_targets": (topics.SERVO_TARGETS, layout.servos),
            "motions": (topics.MOTIONS, layout.motions),
        }
        optional = {kind: topic for kind, (topic, exists) in optional.items() if exists}
        names = {
            **topics.of_motion(bodies, own, lambda topic: topic.resolved(NODE)),
            "inputs": topics.INPUTS.resolved(NODE),
            "events": topics.EVENTS.resolved(NODE),
            "clock": None,
            "diagnostics": topics.DIAGNOSTICS.resolved(NODE),
            **{kind: topic.resolved(NODE) for kind, topic in optional.items()},
        }
        self._reports = JointReports(simulation) if has_reports(layout) else None
        try:
            types = [topic.type for topic in (*motion, *optional.values(), topics.INPUTS, topics.EVENTS)]
            for message_type in [*types, *(message_type for _, message_type, _ in on_request)]:
                schemas.definition(message_type)
                schemas.type_hash(message_type)
            self._recorder = Recorder(
                path,
                attachments.at_start(simulation, NODE, WORLD_FRAME, every, names, simulation.time_ns),
                continues=False,
            )
        except schemas.SchemaError as error:
            raise OutputError(f"{path}: {error}; *.npz needs no ROS") from None
        except RecorderError as error:
            raise OutputError(str(error)) from None
        self._checkpoints = Checkpoints(self._recorder, simulation)
        self._encode_errors, self._encode_laws = estimates.encoder(bodies), law_states.encoder(layout)
        self._channels = [self._channel(topic) for topic in motion]
        optional["inputs"] = topics.INPUTS
        of = ("errors", "inputs", "servo_targets", "motions", "joint_modes", "laws")  # in the order of their channels
        self._of = {kind: self._channel(optional[kind]) for kind in of if kind in optional}
        self._encode_targets, self._encode_motions = commands.servo_targets(layout), commands.motions(layout)
        self._on_request = [
            (self._channel(topics.Topic(name, message_type)), encode) for name, message_type, encode in on_request
        ]
        self._impulses = [
            (self._channel(topics.Topic(name, kind, depth=topics.IMPULSES_KEPT)), encode)
            for name, kind, encode in impulses
        ]
        self._events = self._channel(topics.EVENTS)
        self._event(simulation.time_ns, "start", f"{simulation.scene.name} at step {simulation.steps}, without a clock")
        self._report("begin")
        self._write_targets(simulation.time_ns)

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self._recorder.close()
        if self._recorder.failure and not self._recorder.is_lost and not self._recorder.written:
            self._recorder.path.unlink()  # nothing to recover
        if exception[0] is None:
            self._check()

    def _check(self):
        """Raise OutputError or FileLostError if the recording failed: the recorder raises no disk errors."""
        failure = self._recorder.failure
        if failure:
            raise (FileLostError if self._recorder.is_lost else OutputError)(failure)

    def _channel(self, topic):
        return self._recorder.add_channel(topic.resolved(NODE), topic.type, topic.qos, topic.depth)

    def _event(self, stamp_ns, name, text, level=LogCodec.INFO):
        self._recorder.write(self._events, stamp_ns, LogCodec.encode(stamp_ns, level, name, text))

    def _report(self, which):
        """Record the modes, events and impulses of joints with stops or friction."""
        if self._reports is None:
            return
        due = [(r.time_ns, partial(self._write, r)) for r in getattr(self._reports, which)()]
        if self._impulses:
            impacts = self._simulation.drain_impacts()
            due += [(i.time_ns, partial(self._impact, i)) for i in impacts]
            due.sort(key=itemgetter(0))
        for _, write in due:
            write()

    def _write(self, report):
        if report.modes is not None:
            self._recorder.write(self._of["joint_modes"], report.time_ns, report.modes)
        if report.line is not None:
            self._event(report.time_ns, report.name, report.line)

    def _impact(self, impact):
        for (channel, encode), impulse in zip(self._impulses, impact.array):
            self._recorder.write(channel, impact.time_ns, encode(impact.time_ns, impulse))

    def _write_inputs(self):
        """Record the commands since the last sample, at its stamp, and what changed since, where it changed."""
        given = self._simulation.drain_applied()
        wrenches = [command for command in given if command.kind not in (TARGET, MOTION)]
        if wrenches:
            self._recorder.write(self._of["inputs"], self._stamp, inputs.encode(0, wrenches))
        changes = [command for command in given if command.kind in (TARGET, MOTION)]
        for time_ns, at_once in groupby(changes, attrgetter("start_ns")):
            self._values |= {command.name: command.values for command in at_once}
            self._write_targets(round(time_ns))

    def _write_targets(self, stamp):
        """Record the targets of all servos and the motions of all driven joints from a stamp on."""
        layout, values = self._simulation.layout, self._values
        if layout.servos:
            targets = self._encode_targets(stamp, [values[joint] for joint in layout.servos])
            self._recorder.write(self._of["servo_targets"], stamp, targets)
        if values.keys() & layout.motions.keys():
            rows = [number for joint in layout.motions for number in values.get(joint, FROM_SCENE)]
            self._recorder.write(self._of["motions"], stamp, self._encode_motions(rows))

    def sample(self, sample):
        """Record poses, twists, estimated errors of all bodies, inputs, and events at joints."""
        self._check()
        stamp = sample.time_ns
        self._write_inputs()
        self._stamp = stamp
        self._report("drain")
        for name, text in events.reports(self._simulation):
            if name not in self._told:
                self._told.add(name)
                self._event(stamp, name, text)
        for channel, message in zip(self._channels, self._encode(stamp, sample)):
            self._recorder.write(channel, stamp, message)
        if "errors" in self._of:
            self._recorder.write(self._of["errors"], stamp, self._encode_errors(sample))
        if "laws" in self._of:
            self._recorder.write(self._of["laws"], stamp, self._encode_laws(sample))
        for channel, encode in self._on_request:
            self._recorder.write(channel, stamp, encode(stamp, sample))
        self._checkpoints.add_if_due(stamp)
        self.count, self.last_step = self.count + 1, sample.steps

    def finish(self, simulation, stopped, failed, wall_seconds):
        """Record how the run ended, and its speed."""
        stamp = simulation.time_ns
        self._report("finish")
        if failed:
            self._event(stamp, "fault", stopped, LogCodec.ERROR)
        self._event(stamp, "stop", stopped or f"stopped at step {simulation.steps}")
        self._recorder.add_attachment(
            "pacing.json",
            *attachments.as_json(
                {
                    "ticks": None,
                    "overruns": None,
                    "reanchored": None,
                    "lateness_us": {"p50": None, "p99": None, "max": None},
                    "real_time_factor_wanted": 0.0,
                    "real_time_factor": simulation.time / wall_seconds if wall_seconds > 0.0 else None,
                    "wall_seconds": wall_seconds,
                    "sim_seconds": simulation.time,
                }
            ),
        )
