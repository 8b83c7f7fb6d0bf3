# SPDX-License-Identifier: Apache-2.0
"""Interpolation and refusal of trajectories, and arrays of commands; no ROS node runs here."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from scene_files import cases, text_of
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from liegroup_core import Simulation
from liegroup_core.layout import make_layout
from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.messages.codecs import MessageError
from liegroup_sim_ros.messages.commands import Point, decode_array, decode_trajectory
from liegroup_sim_ros.serving.counted_input import FARTHEST, MOST, Refusal
from liegroup_sim_ros.serving.joint_command_input import JointCommandInput
from liegroup_sim_ros.serving.joint_input import Jumps
from liegroup_sim_ros.serving.trajectory import Follower, Waypoints, between
from liegroup_sim_ros.serving.trajectory_input import TrajectoryInput

NOW = 5 * 10**9
SCENE = text_of("joints_trajectory.yaml")


@pytest.fixture(scope="module")
def layout():
    return make_layout(scene_from_text(SCENE))


def message(names=("pin", "rail"), points=(), stamp_ns=0):
    """points : [(seconds, positions, velocities, accelerations, effort)], the last ones optional."""
    found = JointTrajectory(joint_names=list(names))
    found.header.stamp.sec, found.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    for seconds, *numbers in points:
        fields = zip(("positions", "velocities", "accelerations", "effort"), numbers)
        point = JointTrajectoryPoint(**{name: list(map(float, each)) for name, each in fields})
        point.time_from_start.sec, point.time_from_start.nanosec = divmod(round(seconds * 1e9), 10**9)
        found.points.append(point)
    return serialize_message(found)


@pytest.mark.parametrize("degree", [1, 3, 5])
def test_segments_are_the_polynomials_that_their_ends_determine(degree):
    """A random polynomial of this degree comes back, at any time between the ends."""
    random = np.random.default_rng(degree)
    exact = np.polynomial.Polynomial(random.normal(size=degree + 1))
    rate, slope = exact.deriv(), exact.deriv(2)
    length = 1.7

    def end(t):
        known = exact(t), rate(t), slope(t)
        return tuple(value if 2 * k < degree else None for k, value in enumerate(known))

    for t in np.linspace(0.0, length, 7):
        found = between(end(0.0), end(length), length, t)
        assert found == pytest.approx((exact(t), rate(t)), abs=1e-12)


def test_a_segment_between_points_that_differ_in_kind_is_that_of_the_poorer_one():
    whole = (0.0, 1.0, 2.0), (3.0, 4.0, 5.0)
    for k in (1, 2):
        poorer = tuple((*end[:k], *(None,) * (3 - k)) for end in whole)
        for ends in ((poorer[0], whole[1]), (whole[0], poorer[1])):
            assert between(*ends, 2.0, 0.7) == between(*poorer, 2.0, 0.7)


def points(*rows):
    return [Point(*row[:3], (), round(row[3] * 1e9)) for row in rows]


def test_a_trajectory_begins_at_the_present_state_and_ends_at_rest():
    trajectory = Waypoints(["pin"], points(((1.0,), (0.5,), (), 1.0), ((2.0,), (0.0,), (), 3.0)))
    trajectory.begin([(-1.0, 0.25)])
    assert trajectory.seconds == 3.0
    times = [0.0, 0.5, 1.0, 2.0, 3.0, 9.0]
    found = [state for time in times for state in trajectory.at(time)]
    assert found[0] == (-1.0, 0.25) and found[2] == pytest.approx((1.0, 0.5))
    assert found[4] == found[5] == (2.0, 0.0)
    first, second = (-1.0, 0.25, None), (1.0, 0.5, None)
    assert found[1] == between(first, second, 1.0, 0.5)
    assert found[3] == between(second, (2.0, 0.0, None), 2.0, 1.0)


def test_a_first_point_at_time_zero_is_a_jump():
    trajectory = Waypoints(["pin"], points(((1.0,), (), (), 0.0), ((2.0,), (), (), 1.0)))
    trajectory.begin([(-1.0, 0.0)])
    assert trajectory.at(0.0) == [(1.0, 1.0)] and trajectory.at(0.5) == [(1.5, 1.0)]


def followed(trajectory, step=1e-3, period=2e-3, seconds=1.0, more=lambda *_: None):
    """(times, positions of the pin) of a simulation whose servos follow a trajectory from 0.1003 s."""
    simulation = Simulation(scene_from_text(SCENE), "rkmk4", step, estimate=False)
    follower = Follower(simulation, period, 0.02)
    follower.follow(trajectory, 0.1003)
    times, positions = [], []
    while simulation.time < seconds:
        more(simulation, follower)
        follower.command(simulation.time + 10 * step)
        simulation.advance(10)
        times.append(simulation.time)
        positions.append(simulation.sample().joint_coordinates["pin"][0])
    return np.array(times), np.array(positions), follower


LIMITED = SCENE.replace("pin, type", "pin, data: {lower: -2.5, upper: 2.5, velocity: 8}, type")
BEYOND = [
    (points(((2.0,), (), (), 0.01)), None, "would need 200 rad/s to reach 2 rad in time"),
    (
        points(((2.4,), (8.0,), (), 1.0), ((2.4,), (0.0,), (), 1.5)),
        "would pass 2.99259 rad on its way to 2.4 rad",
        None,
    ),
    (points(((0.1,), (), (), 0.5), ((2.4,), (), (), 0.6)), "would need 23 rad/s", None),
    (points(((0.0,), (9.0,), (), 1.0), ((0.0,), (), (), 2.0)), None, "would need 9 rad/s"),
    (points(((0.0,), (6.0,), (), 9.0), ((0.0,), (0.0,), (), 9.5)), None, "would pass -8 rad"),
]


@pytest.mark.parametrize("rows, at_once, at_start", BEYOND)
def test_targets_of_a_servo_beyond_its_limits_are_refused(rows, at_once, at_start):
    """Segments between points at once, the first one when it starts, as it depends on the state then.

    A cubic to rest at the same position in time T goes 4/27 v T farther: from 8 rad/s in 0.5 s 0.5926 rad.
    """
    simulation = Simulation(scene_from_text(LIMITED), "rkmk4", 1e-3, estimate=False)
    serialized = message(["pin"], [(1e-9 * row.time_ns, *row[:3]) for row in rows])
    reader = TrajectoryInput(simulation.layout)
    if at_once is not None:
        with pytest.raises(Refusal, match=at_once) as caught:
            reader.read(serialized, NOW)
        assert caught.value.reason == "beyond_limits"
        return
    trajectory, refused = reader.read(serialized, NOW), []
    follower = Follower(simulation, 2e-3, 0.02)
    follower.refuse = refused.append
    follower.follow(trajectory, 0.0)
    follower.command(0.01)
    assert len(refused) == 1 and at_start in refused[0] and "\n" not in refused[0]
    assert follower.is_idle and simulation.input_count == 0


def test_a_servo_joint_beyond_its_limits_can_return():
    simulation = Simulation(scene_from_text(LIMITED), "rkmk4", 1e-3, estimate=False)
    unlimited = Simulation(scene_from_text(SCENE), "rkmk4", 1e-3, estimate=False)
    unlimited.place(joints={"pin": (2.6, 9.0)})
    simulation.set_state(*unlimited.state())
    follower = Follower(simulation, 2e-3, 0.02)
    follower.follow(Waypoints(["pin"], points(((2.0,), (0.0,), (), 1.0))), 0.0)
    follower.command(0.01)
    assert not follower.is_idle


def test_servos_follow_a_trajectory():
    """A stiff servo of 100 rad/s, a slow quintic: within what it lags, acceleration / 100^2."""
    target = Waypoints(["pin"], points(((1.0,), (0.0,), (0.0,), 0.5)))
    times, found, follower = followed(target)
    s = np.clip((times - 0.1003) / 0.5, 0.0, 1.0)
    # No acceleration is known at the start: the segment is a cubic, at most 6 / 0.5^2 rad/s^2.
    assert np.abs(found - (3 * s**2 - 2 * s**3)).max() < 24.0 / 100.0**2 * 1.5
    assert found[-1] == pytest.approx(1.0, abs=1e-6) and follower.is_idle


def test_the_targets_are_those_of_the_middle_of_each_period():
    """Half the period, a fourth of the deviation, in an arc that both periods divide."""
    apart = []
    for period in (0.02, 0.01, 1e-4):
        target = Waypoints(["pin"], points(((1.0,), (0.0,), (), 0.6)))
        apart.append(followed(target, period=period, seconds=0.6)[1])
    first, second = (np.abs(one - apart[2]).max() for one in apart[:2])
    assert 1e-6 < second < first / 3.0


def test_a_new_trajectory_replaces_the_former_at_its_start():
    def more(simulation, follower):
        if abs(simulation.time - 0.2) < 1e-9:
            after = Waypoints(["rail"], points(((0.3,), (0.0,), (), 0.2)))
            follower.follow(after, 0.3)

    target = Waypoints(["pin"], points(((1.0,), (), (), 0.5)))
    times, found, follower = followed(target, more=more)
    # It stays where it was to be, after 0.1997 s at 2 rad/s.
    assert found[-1] == pytest.approx(2.0 * 0.1997, abs=1e-6) and follower.is_idle


def test_a_joint_that_something_else_commands_leaves_the_trajectory():
    def more(simulation, follower):
        if abs(simulation.time - 0.3) < 1e-9:
            simulation.command_servo("pin", -0.5, start=0.35)
            follower.release("pin", 0.35)

    target = Waypoints(["pin", "rail"], points(((1.0, 0.2), (), (), 0.5)))
    times, found, _ = followed(target, more=more)
    assert found[times <= 0.35].max() > 0.4 and found[-1] == pytest.approx(-0.5, abs=1e-4)


GOOD = [(0.5, (0.1, 0.2), (1, 1)), (1.0, (0.3, 0.1), (0, 0))]


def test_a_trajectory_is_read(layout):
    reader = TrajectoryInput(layout)
    found = reader.read(message(["rail", "pin"], GOOD, NOW + 7), NOW)
    assert (found.joints, found.stamp_ns, found.seconds) == (["rail", "pin"], NOW + 7, 1.0)
    assert found.at(0.5) == [(0.1, 1.0), (0.2, 1.0)]
    assert reader.read(message(points=GOOD, stamp_ns=10 * NOW), NOW, stamped=False).stamp_ns == 0
    # One that has begun but not ended.
    assert reader.read(message(points=GOOD, stamp_ns=NOW - 10**9 + 1), NOW)
    assert reader.accepted == 3 and not any(reader.refused.values())


def last(*fields, seconds=1.0):
    return [GOOD[0], (seconds, *fields)]


@pytest.mark.parametrize(
    "changed, reason",
    [
        ({"points": last((math.nan, 0))}, "not_finite"),
        ({"points": last((0, 0), (0, math.inf))}, "not_finite"),
        ({"points": last((0, 0), (), (math.nan, 0))}, "not_finite"),
        ({"points": last((0,))}, "wrong_length"),
        ({"points": last(())}, "wrong_length"),
        ({"points": last((0, 0), (0, 0, 0))}, "wrong_length"),
        ({"names": ["pin", "rial"], "points": GOOD}, "unknown_joint"),
        ({"names": ["pin", "pin"], "points": GOOD}, "repeated_joint"),
        ({"names": ["pin", "free"], "points": GOOD}, "no_servo"),
        ({"points": []}, "no_points"),
        ({"names": [], "points": []}, "no_points"),
        ({"points": last((0, 0), seconds=0.5)}, "wrong_times"),
        ({"points": last((0, 0), seconds=0.4)}, "wrong_times"),
        ({"points": [(-0.5, (0, 0)), GOOD[1]]}, "wrong_times"),
        ({"points": last((0, 0), (0, 1))}, "moving_at_end"),
        ({"points": last((0, 0), (), (), (0, 1))}, "effort"),
        ({"points": GOOD, "stamp_ns": NOW - 10**9 - 1}, "stamp_too_old"),
        ({"points": GOOD, "stamp_ns": NOW + FARTHEST + 1}, "stamp_too_far"),
        ({"names": ["pin"] * 9, "points": GOOD}, "damaged"),
    ],
)
def test_refused_trajectories_are_one_line(layout, changed, reason):
    reader = TrajectoryInput(layout)
    with pytest.raises(Refusal) as caught:
        reader.read(message(**changed), NOW)
    assert caught.value.reason == reason and caught.value.is_told
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 300
    assert reader.accepted == 0 and reader.refused[reason] == 1


@pytest.mark.parametrize("points, fits", cases("a_trajectory_that_jumps_is_refused"))
def test_a_trajectory_that_jumps_is_refused(layout, points, fits):
    """The first segment begins at the present positions."""
    reader, jumps = TrajectoryInput(layout), Jumps(0.1, {"pin": 0.0, "rail": 0.0}, 0.002)
    if fits:
        assert reader.read(message(points=points), NOW, jumps=jumps)
        return
    with pytest.raises(Refusal) as caught:
        reader.read(message(points=points), NOW, jumps=jumps)
    assert caught.value.reason == "jump_too_large" and "at once" in str(caught.value)


@given(st.binary(max_size=200))
def test_arbitrary_bytes_do_not_crash_the_decoders(payload):
    whole = message(points=GOOD)
    for start in (b"", b"\0\1\0\0", whole[: len(whole) // 2]):
        for decode in (lambda data: decode_trajectory(data, 5), decode_array):
            try:
                decode(start + payload)
            except MessageError as error:
                assert "\n" not in str(error)


@given(st.lists(st.floats(), max_size=5), st.lists(st.text("ab", max_size=5), max_size=3))
def test_arrays_serialized_by_ros_are_decoded(numbers, labels):
    dimensions = [MultiArrayDimension(label=label, size=3, stride=3) for label in labels]
    array = Float64MultiArray(data=numbers, layout=MultiArrayLayout(dim=dimensions))
    assert repr(list(decode_array(serialize_message(array)))) == repr(numbers)


def test_an_array_commands_one_interface_of_the_joints(layout):
    reader, names = JointCommandInput(layout, 0.02), ("rail", "pin")

    def read(*numbers, interface="effort", held=0):
        array = serialize_message(Float64MultiArray(data=list(map(float, numbers))))
        return reader.read_array(array, names, interface, held)

    assert [(c.name, *c.values) for c in read(1, math.nan)] == [("rail", 1.0)]
    found = read(1, 2, interface="position")
    assert [(c.name, *c.values) for c in found] == [("rail", 1, 0), ("pin", 2, 0)]
    for arguments, reason in (
        ({"numbers": (1,)}, "wrong_length"),
        ({"numbers": (1, math.inf)}, "not_finite"),
        ({"numbers": (1, 2), "interface": "velocity"}, "no_position"),
        ({"numbers": (1, 2), "held": MOST}, "too_many"),
    ):
        with pytest.raises(Refusal) as caught:
            read(*arguments.pop("numbers"), **arguments)
        assert caught.value.reason == reason
