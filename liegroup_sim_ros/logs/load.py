# SPDX-License-Identifier: Apache-2.0
"""Log of a bag and a map: values in SI units, times that increase, and notes on what was lost."""

from dataclasses import replace
from urllib.parse import unquote

import numpy as np
from scipy.spatial.transform import Rotation

from liegroup_core.errors import SceneError
from liegroup_core.identification.log import MOTION, SPLINE, Given, Log, Measured
from liegroup_core.linear.channels import WRENCH
from liegroup_core.observables.quantities import ACCELERATION, POSITION, ROTATION, TWIST, present_name
from liegroup_sim_ros.messages import estimates
from liegroup_sim_ros.numbers import counted

from .bag import BagError, Field

_SIX = (("angular", "xyz"), ("linear", "xyz"))
# {part of a body: (its outputs or inputs, path in a message, vectors there with their components)}
WHOLE = {
    "pose": ((*POSITION, *ROTATION), "", (("position", "xyz"), ("orientation", "xyzw"))),
    "twist": (TWIST, "", _SIX),
    "acceleration": (ACCELERATION, "", _SIX),
    "wrench": (WRENCH, "wrench", (("torque", "xyz"), ("force", "xyz"))),
}
_IMU = ("orientation", "xyzw"), ("angular_velocity", "xyz"), ("linear_acceleration", "xyz")
OF_SENSORS = {"force_torque": WHOLE["wrench"], "imu": ((), "", _IMU)}
TRANSFORM = ("translation", "xyz"), ("rotation", "xyzw")  # instead of a pose
GAP = 5.0  # of the usual time between two messages: a longer one is a gap
NS = 1e9
LATE_STAMPS = 86400.0  # s between stamps and the times of recording: clocks without a common origin
# s between clocks, by the times of recording: what is below may be latency; of it 90 % differ by less than the second.
APART, STEADY = 0.5, 0.25


def fields_of(entry, scene, kind):
    """[Field] of a map's entry, in the order of `channels_of`.

    kind : of the message
    """
    name, _, part = (getattr(entry, "output", None) or entry.input).partition(".")
    types = {sensor.name: sensor.type for sensor in scene.sensors}
    whole = WHOLE.get(part) if part else OF_SENSORS.get(types.get(name))
    if whole is not None:
        _, usual, vectors = whole
        path = entry.field or usual
        if part == "pose" and path.rpartition(".")[2].partition("[")[0] == "transform":
            vectors = TRANSFORM
        head = f"{path}." if path else ""
        return [Field(f"{head}{vector}.{axis}") for vector, axes in vectors for axis in axes]
    if not entry.field:
        raise SceneError(
            f"{name}{part and '.'}{part}: is not a number: add the field of {kind} that has the value, such as data[0]"
        )
    return [Field(entry.field)]


def channels_of(name, scene):
    """Names of the outputs or inputs that an entry of a map stands for."""
    first, _, part = name.partition(".")
    sensors = {sensor.name: sensor for sensor in scene.sensors}
    if part in WHOLE:
        return [f"{first}.{each}" for each in WHOLE[part][0]]
    if not part and first in sensors:
        if sensors[first].type == "pose":
            raise SceneError(f"{first}: give {first}.0, {first}.1, ... of a pose sensor, or BODY.pose")
        return [f"{first}.{k}" for k in range(len(sensors[first].parts))]
    return [name]


def outputs_of(name, scene):
    """Names of the outputs that an entry of a map stands for, as of the Catalogue."""
    return [present_name(each, scene.sensors) for each in channels_of(name, scene)]


def load_log(bag, given, scene, turns, origin=None):
    """Log of a Bag and a Map.

    turns  : {body: (3, 3)} attitudes at the start of the scene, to which rotation vectors refer
    origin : ns, stamp at the start of the log; None: the first stamp
    Raises BagError, SceneError.
    """
    wanted, of, errors = {}, {}, _errors(bag, scene)
    for entry in (*given.inputs, *given.measurements):
        if entry.topic not in bag.topics:
            bag.read({entry.topic: []})  # raises BagError
        fields = fields_of(entry, scene, bag.topics[entry.topic])
        begin = len(wanted.setdefault(entry.topic, []))
        wanted[entry.topic] += fields
        of[id(entry)] = slice(begin, begin + len(fields))
    found, notes = bag.read(wanted), []
    times = {topic: _times(topic, messages, notes) for topic, messages in found.items()}
    delays = {clock.topic: clock.delay for clock in given.clocks}
    moved = _moved(found, times, delays, notes)
    times = {topic: (stamps + moved[topic], rows) for topic, (stamps, rows) in times.items()}
    first = min(int(stamps[0]) for stamps, _ in times.values())
    origin = first if origin is None else origin
    seconds = {topic: (stamps - origin) * 1e-9 for topic, (stamps, _) in times.items()}
    spans = [each[-1] for each in seconds.values()]
    for topic, each in seconds.items():
        if (span := each[-1] - each[0]) > LATE_STAMPS:
            raise BagError(f"the stamps of {topic} span {span:.6g} s, more than a day: check their unit")
    whole = max(spans) - (first - origin) * 1e-9
    if max(each[0] for each in seconds.values()) > max(spans) or whole > LATE_STAMPS:
        late = max(seconds, key=lambda topic: seconds[topic][0])
        raise BagError(
            f"the stamps of {late} are {seconds[late][0]:.6g} s after the others: their clocks have no common origin"
        )
    inputs = []
    for entry in given.inputs:
        values = found[entry.topic].values[times[entry.topic][1], of[id(entry)]] * entry.factor + entry.offset
        for name, column in zip(channels_of(entry.input, scene), values.T):
            known = np.isfinite(column)
            if not known.all():
                missing = counted(int((~known).sum()), "message")
                notes.append(f"{entry.topic}: {missing} without a finite number for {name}: left out")
            at = seconds[entry.topic][known]
            inputs.append(Given(name, at, column[known], entry.way, entry.noise, _parts(at, entry.way)))
    acting, drives = ([each for each in inputs if each.name.endswith(MOTION) == is_drive] for is_drive in (False, True))
    measured = []
    for topic in dict.fromkeys(entry.topic for entry in given.measurements):
        names, columns, noise = [], [], []
        for entry in given.measurements:
            if entry.topic != topic:
                continue
            values = found[topic].values[times[topic][1], of[id(entry)]]
            own = outputs_of(entry.output, scene)
            columns.append(_values(entry, values, turns, {sensor.name: sensor for sensor in scene.sensors}))
            names += own
            noise += [np.nan if entry.noise is None else entry.noise] * len(own)
        for name in names:
            if names.count(name) > 1:
                raise SceneError(f"{name} is given twice on {topic}: keep one")
        at, values = seconds[topic], np.hstack(columns)
        for drive in drives:
            if not (covered := drive.covers(at)).all():
                notes.append(
                    f"{topic}: {counted(int((~covered).sum()), 'message')} where {drive.name} is not known: left out"
                )
                at, values = at[covered], values[covered]
        if not len(at):
            raise SceneError(f"{topic}: all its messages are outside of those of {drive.name}")
        clock = delays.get(topic), moved[topic] * 1e-9
        error = np.array([errors.get(name, 0.0) for name in names])
        measured.append(Measured(topic, at, tuple(names), values, np.array(noise), *clock, error))
    if not inputs and all(each.delay is None for each in measured):
        # Without inputs only differences of clocks show.
        measured[0] = replace(measured[0], delay=0.0)
    return Log(tuple(acting), tuple(measured), tuple(notes), drives=tuple(drives))


def _errors(bag, scene):
    """{output: largest error, SI units} of a simulation that has published estimates of them (messages/estimates.py).

    Errors of joints are the sums of those of their bodies.
    """
    of_bodies = {}
    for topic in (topic for topic, kind in bag.topics.items() if kind == estimates.TYPE):
        for message in bag.messages(topic):
            labels = [each["label"].split(" ") for each in message["layout"]["dim"]]
            if labels[1:] != [list(estimates.UNITS)] or len(message["data"]) != 4 * len(labels[0]):
                break
            rows = np.nan_to_num(np.reshape(message["data"], (-1, 4)), posinf=0.0)
            for body, row in zip(map(unquote, labels[0]), rows):
                of_bodies[body] = np.maximum(row, of_bodies.get(body, 0.0))
    found = {}
    for body, (m, rad, speed, rate) in of_bodies.items():
        for names, errors in ((POSITION, [m] * 3), (ROTATION, [rad] * 3), (TWIST, [rate] * 3 + [speed] * 3)):
            found |= {f"{body}.{name}": error for name, error in zip(names, errors)}
    for joint in scene.joints:
        own = sum(of_bodies.get(body, np.zeros(4)) for body in (joint.parent, joint.child))
        found[f"{joint.name}.position"], found[f"{joint.name}.velocity"] = own[[0, 2]] + own[[1, 3]]
    return found


def _parts(times, hold):
    """Rows of an input with which a spline begins: the first one, and those after gaps."""
    if hold != SPLINE or len(times) < 2:
        return (0,)
    steps = np.diff(times)
    return (0, *(np.flatnonzero(steps > GAP * np.median(steps)) + 1).tolist())


def _is_rotation(quaternion):
    """(k,) whether rows (k, 4) are quaternions of rotations."""
    with np.errstate(invalid="ignore"):
        return np.linalg.norm(quaternion, axis=1) > 0.5


def _values(entry, values, turns, sensors):
    """(k, p) of a map's entry in SI units, with rotation vectors for quaternions of poses.

    Quaternions that are no rotation are unknown ones; encoders round down, so that half a step is added.
    """
    name, _, part = entry.output.partition(".")
    sensor = sensors.get(name)
    if part != "pose":
        values = values * entry.factor + entry.offset
        if sensor is not None and sensor.type == "imu" and not part:
            values[~_is_rotation(values[:, :4]), :4] = np.nan
        if sensor is not None and sensor.type == "encoder":
            values += 0.5 * (sensor.resolution or 0.0)
        return values
    if name not in turns:
        raise SceneError(f"{entry.output}: the scene has no body {name}")
    position, quaternion = values[:, :3] * entry.factor, values[:, 3:]
    usable = _is_rotation(quaternion)
    rotation = Rotation.identity(len(values))
    if usable.any():
        filled = np.where(usable[:, None], quaternion, [0.0, 0.0, 0.0, 1.0])
        rotation = Rotation.from_quat(filled)
    if entry.world is not None:
        frame = entry.world.pose
        position = position @ frame[:3, :3].T + frame[:3, 3]
        rotation = Rotation.from_matrix(frame[:3, :3]) * rotation
    vectors = (Rotation.from_matrix(turns[name].T) * rotation).as_rotvec()
    vectors[~usable] = np.nan
    return np.hstack([position + entry.offset, vectors])


def _moved(found, times, delays, notes):
    """{topic: ns} by which times are moved to the clock of the first topic, an input if there is one.

    Clocks differ by the medians of what the times of recording are later than the stamps, if that is constant.

    delays : {topic: s} that are given: these are not moved
    """
    late, moved = {}, {}
    for topic, (stamps, rows) in times.items():
        low, middle, high = np.quantile(found[topic].log_ns[rows] - stamps, [0.05, 0.5, 0.95]) / NS
        late[topic] = middle
        if high - low > STEADY:
            late[topic] = np.nan
            spread = f"{low:.6g} s to {high:.6g} s after the stamps, {high - low:.2g} s apart"
            notes.append(f"{topic}: the times of recording are {spread}")
    first = next(iter(late))
    for topic, middle in late.items():
        apart = middle - late[first]
        moved[topic] = round(apart * NS) if abs(apart) > APART and topic not in delays else 0
        if moved[topic]:
            sign = "behind" if apart > 0.0 else "ahead of"
            notes.append(f"{topic}: its clock is {abs(apart):.6g} s {sign} that of {first}, by the times of recording")
    return moved


def _times(topic, messages, notes):
    """(times in ns that increase, rows of the messages with them); what is left out is noted.

    Messages with one stamp become one, with the values of each: several drivers may publish on a topic.
    """
    stamped = messages.stamp_ns > 0
    if stamped.any() and messages.stamp_ns[stamped].min() < LATE_STAMPS * NS:
        stamped = messages.stamp_ns >= 0  # a clock that began lately: 0 is a time of it
    stamps, own = (messages.stamp_ns, stamped) if stamped.any() else (messages.log_ns, ~stamped)
    if not own.all():
        notes.append(f"{topic}: {counted(int((~own).sum()), 'message')} without a stamp: left out")
    elif not stamped.any():
        notes.append(f"{topic}: without stamps; times are those of recording")
    kept = np.flatnonzero(own)
    if (np.diff(stamps[kept]) < 0).any():
        back = int((np.diff(stamps[kept]) < 0).sum())
        notes.append(f"{topic}: {back} messages are earlier than the one before: sorted")
    order = kept[np.argsort(stamps[kept], kind="stable")]
    firsts = np.concatenate([[True], np.diff(stamps[order]) > 0])
    rows, same = order[firsts], 0
    for row, into in zip(order[~firsts], rows[np.cumsum(firsts)[~firsts] - 1]):
        new = np.isfinite(messages.values[row]) & np.isnan(messages.values[into])  # as from two drivers
        messages.values[into, new] = messages.values[row, new]
        same += not new.any()
    if same:
        notes.append(f"{topic}: {same} messages have the stamp of another one: left out")
    steps = np.diff(stamps[rows])
    usual = float(np.median(steps)) if len(steps) else 0.0
    gaps = steps > GAP * usual
    if gaps.any():
        most = int(steps.argmax())
        when = (stamps[rows][most] - stamps[rows][0]) * 1e-9
        notes.append(
            f"{topic}: {int(gaps.sum())} gaps, the longest {steps[most] * 1e-9:.3g} s, {when:.6g} s after its start"
        )
    return stamps[rows], rows
