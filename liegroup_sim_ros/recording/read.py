# SPDX-License-Identifier: Apache-2.0
"""Reader of recordings: settings and initial state of a run, and its messages as arrays.

The file is read from front to back, chunk by chunk. An unfinished file (killed process, full disk)
is read up to its last flush without repair; `complete` and `problem` report it. Damaged chunks are
skipped and reported; `lost` counts missing messages by sequence number. No ROS is needed. Every
failure is a RecordingError, one line of text.

Events, inputs and diagnostics are kept in memory. Poses, twists and estimated errors are loaded
on first access: 64, 56, and 8 + 32 n bytes a message of n bodies. `samples` returns them in pieces
instead, in bounded memory.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from liegroup_core.joints.motion import COLUMNS
from liegroup_sim_ros.messages import arrays, estimates, joint_modes, law_states, matrices
from liegroup_sim_ros.messages.codecs import PoseStampedCodec, TwistStampedCodec, WrenchStampedCodec
from liegroup_sim_ros.messages.commands import JOINT_STATE, JointStateDecoder

from .addresses import is_remote
from .errors import RecordingError
from .frames import data_frame
from .input_track import InputTrack
from .read_file import Attachments, ErrorsWithPath, RecordingBytes, Scan, decode, of_one_size
from .tracks import (
    ErrorTrack,
    ImpulseTrack,
    JointTrack,
    ModeTrack,
    MotionTrack,
    PoseTrack,
    ReactionTrack,
    Samples,
    TwistTrack,
)

FORMAT = 1  # of settings.json and the other attachments
REACTION = "/wrench"  # ending of the topics of reactions; inputs are not recorded
IMPULSE = "/impulse"  # ending of the topics of impulses at impacts
OF_BODY = "_reaction"  # before these endings, if the joint has the name of a body
# Numbers in a piece of `samples`, and the largest offset between two topics of a file in samples.
PIECE, MOST_APART = 200_000, 100_000
NUMBERS = {"pose": 7, "twist": 6, "errors": 4, "laws": 1}  # of one body, or state of a law
OF_ALL = ("errors", "laws")  # kinds with one message for all
# Decoders of messages about several bodies: (rows, names, world frame) -> numbers.
SEVERAL = {
    ("pose", arrays.TYPE): arrays.decode_poses,
    ("twist", matrices.TYPE): arrays.decode_twists,
    ("errors", matrices.TYPE): estimates.decode_rows,
    ("laws", law_states.TYPE): law_states.decode_rows,
}


@dataclass(frozen=True, eq=False)
class Recording:
    """Contents of a recording, from `read_recording`."""

    path: Path | str  # str: an address
    scene_text: str
    settings: dict  # settings.json
    initial_state: dict  # initial_state.json
    pacing: dict | None  # pacing.json; None if the run did not end normally
    bodies: tuple  # names, in the order of initial_state
    inputs: InputTrack  # wrenches and efforts as they were commanded
    servo_targets: JointTrack | None  # targets of all servos from each stamp on
    motions: MotionTrack | None  # motions of all driven joints from each stamp on
    joint_modes: ModeTrack | None  # of the joints with stops or friction, from each stamp on
    events: list  # Event
    diagnostics: list  # (stamp_ns, {key: text}), the values of all statuses of a message
    topics: dict  # {topic: message count}
    complete: bool  # the file is finished and undamaged
    lost: dict  # {topic: messages missing by sequence number}; empty if none
    problem: str | None  # None or one line for the user
    last_ns: int  # last stamp
    channels: dict = field(repr=False)  # {id: walk.Channel}
    _source: RecordingBytes = field(repr=False)

    @property
    def checkpoints(self) -> list[int]:
        """Stamps of the checkpoints in ns, sorted."""
        return self._source.checkpoints

    def checkpoint(self, stamp_ns: int) -> dict:
        """State at a checkpoint, with the entries of initial_state. Raises RecordingError."""
        with ErrorsWithPath(self.path):
            return self._source.checkpoint(stamp_ns)

    @property
    def pose(self) -> dict[str, PoseTrack]:
        """{body: PoseTrack}, loaded on first access."""
        return {
            body: PoseTrack(stamps, values[:, :3], values[:, 3:])
            for body, (stamps, values) in self._tracks["pose"].items()
        }

    @property
    def twist(self) -> dict[str, TwistTrack]:
        """{body: TwistTrack}, loaded on first access."""
        return {body: TwistTrack(*track) for body, track in self._tracks["twist"].items()}

    @property
    def errors(self) -> ErrorTrack | None:
        """ErrorTrack, loaded on first access; None if the run had no estimate."""
        track = self._tracks["errors"].get(None)
        return track and ErrorTrack(*track)

    @cached_property
    def _tracks(self):
        wanted = self._motion_topics()
        rows = {topic: self.topics.get(topic, 0) for topic in wanted}
        tracks = {
            topic: (np.empty(rows[topic], dtype=np.int64), np.empty((rows[topic], *_shape(*of))))
            for topic, of in wanted.items()
        }
        done = dict.fromkeys(wanted, 0)
        for topic, stamps, values in self._decoded(wanted):
            at = slice(done[topic], done[topic] + len(stamps))
            tracks[topic][0][at], tracks[topic][1][at] = stamps, values
            done[topic] += len(stamps)
        result = {"pose": {}, "twist": {}, "errors": {}, "laws": {}}
        for topic, (kind, index) in wanted.items():
            stamps, values = tracks[topic]
            parts = {None: values} if kind in OF_ALL else {self.bodies[i]: values[:, k] for k, i in enumerate(index)}
            result[kind] |= {body: (stamps, part) for body, part in parts.items()}
        return result

    @cached_property
    def joint_states(self) -> JointTrack | None:
        """JointTrack of ~/joint_states, or None if the topic was not recorded."""
        found, decoder = [], JointStateDecoder()
        targets = self.settings["topics"].get("servo_targets")
        with ErrorsWithPath(self.path):
            for messages, channels in self._source.messages():
                for channel, index in channels:
                    if channel.type == JOINT_STATE and channel.topic != targets:
                        found += [decoder.decode(messages.payload(k)).complete() for k in index]
            return _joint_track(found)

    @cached_property
    def reactions(self) -> dict[str, ReactionTrack]:
        """{joint: ReactionTrack} of ~/JOINT/wrench; also of forces and force-torque sensors, by their names."""
        return self._of_joints(REACTION, ReactionTrack)

    @cached_property
    def impulses(self) -> dict[str, ImpulseTrack]:
        """{joint: ImpulseTrack} of ~/JOINT/impulse; {} if they were not recorded, or there was no impact."""
        return self._of_joints(IMPULSE, ImpulseTrack)

    def _of_joints(self, ending, kind):
        """{joint: track of a kind} of the wrenches on topics ~/JOINT + ending."""
        found: dict[str, list] = {}
        with ErrorsWithPath(self.path):
            for messages, channels in self._source.messages():
                for channel, index in channels:
                    if channel.type == WrenchStampedCodec.TYPE and channel.topic.endswith(ending):
                        joint = channel.topic.removesuffix(ending).rpartition("/")[2]
                        if joint.removesuffix(OF_BODY) in self.bodies:
                            joint = joint.removesuffix(OF_BODY)
                        rows = found.setdefault(joint, [])
                        rows += (WrenchStampedCodec.decode_one(messages.payload(k)) for k in index)
        columns = {joint: zip(*rows) for joint, rows in found.items()}
        return {joint: kind(np.array(stamps), np.array(values)) for joint, (stamps, _, values) in columns.items()}

    def samples(self) -> Iterator[Samples]:
        """Iterator over the samples of all bodies in the order of time: Samples in pieces.

        A sample is the pose and twist of every body at one stamp; incomplete samples are omitted.
        A missing estimate of the errors is NaN. Raises RecordingError.
        """
        wanted = self._motion_topics()
        waiting: dict = {topic: [[], []] for topic in wanted}  # stamps, values
        counts = dict.fromkeys(wanted, 0)
        least = max(64, PIECE // (13 * max(1, len(self.bodies))))
        for topic, stamps, values in self._decoded(wanted):
            waiting[topic][0].append(stamps)
            waiting[topic][1].append(values)
            counts[topic] += len(stamps)
            if counts[topic] >= 2 * least and min(counts.values()) >= least:
                yield from self._merged(wanted, waiting, counts)
            if counts[topic] > MOST_APART + 4 * least:
                raise RecordingError(
                    f"{self.path}: the poses and twists of one sample are more than "
                    f"{MOST_APART} samples apart in the file"
                )
        yield from self._merged(wanted, waiting, counts, ended=True)

    def _merged(self, wanted, waiting, counts, ended=False):
        """Yield the complete samples and remove their messages from `waiting`.

        ended : True: no messages follow, so missing estimates stay NaN
        """
        tracks = {
            topic: (np.concatenate(stamps), np.concatenate(values))
            if stamps
            else (np.empty(0, dtype=np.int64), np.empty((0, *_shape(*wanted[topic]))))
            for topic, (stamps, values) in waiting.items()
        }
        motion = [stamps for topic, (stamps, _) in tracks.items() if wanted[topic][0] not in OF_ALL]
        if not all(map(len, motion)):
            return
        upto = min(int(s[-1]) for s in (motion if ended else [s for s, _ in tracks.values()]))
        common = None
        for stamps in motion:
            ready = stamps[: np.searchsorted(stamps, upto, "right")]
            if common is None or not np.array_equal(common, ready):
                common = ready if common is None else np.intersect1d(common, ready, True)
        k, n, of = len(common), len(self.bodies), {each[0]: each for each in wanted.values()}
        samples = Samples(
            common,
            np.empty((k, n, 3)),
            np.empty((k, n, 4)),
            np.empty((k, n, 6)),
            *(np.full((k, *_shape(*of[kind])), np.nan) if kind in of else None for kind in OF_ALL),
        )
        for topic, (kind, index) in wanted.items():
            stamps, values = tracks[topic]
            if kind in OF_ALL:
                _, rows, places = np.intersect1d(stamps, common, True, return_indices=True)
                getattr(samples, kind)[places] = values[rows]
            else:
                rows = values[np.searchsorted(stamps, common)]
                if kind == "pose":
                    samples.position[:, index], samples.quaternion[:, index] = rows[..., :3], rows[..., 3:]
                else:
                    samples.twist[:, index] = rows
            left = np.searchsorted(stamps, upto, "right")
            waiting[topic][:] = [stamps[left:]], [values[left:]]
            counts[topic] = len(stamps) - left
        if len(common):
            yield samples

    def _motion_topics(self):
        """{topic: (kind, indices of its bodies)} in the order of the bodies, then what is of all of them."""
        topics, found = self.settings["topics"], {}
        for i, body in enumerate(self.bodies):
            for kind in ("pose", "twist"):
                found.setdefault(topics[kind][body], (kind, []))[1].append(i)
        counts = {"errors": len(self.bodies), "laws": len(self._laws)}
        return found | {
            topics[kind]: (kind, range(counts[kind])) for kind in OF_ALL if self.topics.get(topics.get(kind))
        }

    @property
    def _laws(self):
        """Names of the states of laws."""
        names = self.settings.get("laws", [])
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise RecordingError(f"{self.path}: its settings have no valid names of states of laws")
        return names

    def _decoded(self, wanted):
        """(topic, stamps, values (k, bodies, numbers)) of the poses, twists and errors in each chunk."""
        last = {}
        with ErrorsWithPath(self.path):
            for messages, channels in self._source.messages():
                for channel, index in channels:
                    if channel.topic not in wanted:
                        continue
                    for stamps, values in self._values(channel, *wanted[channel.topic], messages, index):
                        before = last.get(channel.topic, stamps[0] - 1)
                        if stamps[0] <= before or (np.diff(stamps) <= 0).any():
                            raise RecordingError(f"the stamps of {channel.topic} do not increase")
                        last[channel.topic] = stamps[-1]
                        yield channel.topic, stamps, values.reshape(-1, *_shape(*wanted[channel.topic]))

    def _values(self, channel, kind, bodies, messages, index):
        """(stamps, values) for runs of messages of one topic about the bodies with these indices."""
        world, known = self.settings.get("world_frame", "world"), self._laws if kind == "laws" else self.bodies
        names = [known[i] for i in bodies]
        several = SEVERAL.get((kind, channel.type))
        if several is not None:
            for part in of_one_size(messages, index):
                yield messages.log_time[part], several(messages.rows(part), names, world)
            return
        if kind in OF_ALL or len(names) > 1:
            raise RecordingError(f"{channel.topic} has messages of the type {channel.type!r:.60}")
        codec = PoseStampedCodec if kind == "pose" else TwistStampedCodec
        frame = world if kind == "pose" else self.settings.get("frame_prefix", "") + names[0]
        for stamps, frames, values in decode(codec, messages, index):
            if frames != [frame]:
                raise RecordingError(f"{channel.topic} is in frame {frames[0]!r:.60}, not in {frame!r:.60}")
            yield stamps, values

    def to_pandas(self, what: str = "motion"):
        """pandas DataFrame with the time in s as index.

        what : "motion"  columns (body, quantity): x, y, z, qx, qy, qz, qw, wx, wy, wz, vx, vy, vz
               "inputs"  columns kind, name, source, axes, tx, ty, tz, fx, fy, fz, stiffness, damping, to_x, to_y,
                         to_z, turning_damping, px, py, pz, start, end: wrenches, efforts (in tx) and pulls as they
                         were given at this time; s; NaN: no point, no end
               "joints"  columns (joint, "position", "velocity" or "effort")
               "motions" columns (driven joint, "origin" or "c0" to "c5"): the commanded motion from
                         this time on, see liegroup_core/joints/motion.py; infinite origin: none
               "servo_targets" columns (joint, "position" or "velocity"): targets from this time on
               "joint_modes" columns (joint, "mode", "slip", "coordinate", "impulse", "energy" or
                         "effort"): of joints with stops or friction, see messages/joint_modes.py
               "impulses"  columns (joint, tx to fz): N m s and N s at impacts, NaN: undetermined
               "reactions" columns (joint, tx to fz): N m and N, NaN: undetermined
               "errors"  columns (body, "position", "attitude", "velocity" or "angular_velocity"):
                         estimated errors in m, rad, m/s, rad/s, as in `errors`
               "events"  columns name, text
        raises ImportError without pandas, ValueError for any other `what`
        """
        return data_frame(self, what)


def _shape(kind, index):
    """Shape of the values in a message about some bodies."""
    return len(index), NUMBERS[kind]


def read_recording(path: str | Path) -> Recording:
    """Recording of a *.mcap file, a path or an fsspec URL. Raises RecordingError."""
    path = str(path) if is_remote(path) else Path(path)
    with ErrorsWithPath(path):
        source = RecordingBytes(path)
        attachments, stream = source.attachments()
        names = Attachments(attachments, stream)
        settings = names.json("settings.json")
        if settings.get("format") != FORMAT:
            raise RecordingError(f"it has format {settings.get('format')!r:.40}, this version reads format {FORMAT}")
        initial_state = names.json("initial_state.json")
        pacing = names.json("pacing.json") if "pacing.json" in attachments else None
        bodies, topics = tuple(initial_state["bodies"]), settings["topics"]
        kinds = [[topics[kind][body] for body in bodies] for kind in ("pose", "twist")]
        if len(set(bodies)) < len(bodies) or not all(isinstance(t, str) for of_kind in kinds for t in of_kind):
            raise RecordingError("its settings lack the topics of a body")
        of_kind = [*map(set, kinds), set() if topics.get("errors") is None else {topics["errors"]}]
        if len(set.union(*of_kind)) < sum(map(len, of_kind)):
            raise RecordingError("its settings have no separate topics for poses, twists and estimated errors")
        scene_text = names["scene.yaml"].decode()
        scan = Scan(source, settings, bodies)
        problem = scan.problem(source, attachments)
        return Recording(
            path=path,
            scene_text=scene_text,
            settings=settings,
            initial_state=initial_state,
            pacing=pacing,
            bodies=bodies,
            inputs=scan.inputs,
            servo_targets=_joint_track(scan.servo_targets),
            motions=_matrices(MotionTrack, scan.motions, COLUMNS, "motions"),
            joint_modes=_matrices(ModeTrack, scan.joint_modes, len(joint_modes.COLUMNS), "joint modes"),
            events=scan.events,
            diagnostics=scan.diagnostics,
            topics=scan.counts(),
            complete=problem is None,
            lost={topic: count for topic, count in scan.lost().items() if count},
            problem=problem and f"{path}: {problem}",
            last_ns=scan.last_ns,
            channels=scan.channels,
            _source=source,
        )


def _joint_track(messages):
    """JointTrack of [(stamp in ns, names, positions, velocities, efforts)]; None without messages.

    Efforts may be omitted.
    """
    if not messages:
        return None
    stamps, names, position, velocity, *efforts = zip(*messages)
    if len(set(names)) > 1:
        raise RecordingError("its joint states have different joints in different messages")
    shape = len(stamps), len(names[0])
    return JointTrack(
        np.array(stamps),
        names[0],
        np.array(position).reshape(shape),
        np.array(velocity).reshape(shape),
        np.array([part or [np.nan] * shape[1] for part in efforts[0]]).reshape(shape)
        if efforts
        else np.full(shape, np.nan),
    )


def _matrices(kind, messages, columns, what):
    """Track of a kind of [(stamp in ns, names, numbers)], in the order of stamps; None without any."""
    if not messages:
        return None
    stamps, names, numbers = zip(*sorted(messages, key=lambda message: message[0]))
    if len(set(names)) > 1:
        raise RecordingError(f"its {what} have different joints in different messages")
    shape = len(stamps), len(names[0]), columns
    return kind(np.array(stamps), names[0], np.array(numbers).reshape(shape))
