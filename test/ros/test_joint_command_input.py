# SPDX-License-Identifier: Apache-2.0
"""Interpretation and refusal of joint commands; no ROS node runs here."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from robot_texts import ARM_URDF
from scene_files import text_of
from sensor_msgs.msg import JointState

from liegroup_core import Simulation, load_scene
from liegroup_core.forces.commands import EFFORT, MOVE, TARGET, Command
from liegroup_core.layout import make_layout
from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.messages.codecs import MessageError
from liegroup_sim_ros.messages.commands import JointStateDecoder, Point
from liegroup_sim_ros.serving.counted_input import FARTHEST, MOST, Refusal
from liegroup_sim_ros.serving.inbox import Inbox
from liegroup_sim_ros.serving.joint_command_input import JointCommandInput
from liegroup_sim_ros.serving.joint_input import Jumps
from liegroup_sim_ros.serving.trajectory import Waypoints

NOW, NAN = 5 * 10**9, math.nan
SCENE = text_of("joints_joint_command_input.yaml")


@pytest.fixture(scope="module")
def layout():
    return make_layout(scene_from_text(SCENE))


def message(names=(), position=(), velocity=(), effort=(), stamp_ns=0):
    state = JointState(name=list(names), position=list(position), velocity=list(velocity), effort=list(effort))
    state.header.stamp.sec, state.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    return serialize_message(state)


@pytest.mark.parametrize(
    "fields, efforts",
    [
        ({"names": ["pin", "rail"], "effort": [1.0, -2.0]}, {"pin": 1.0, "rail": -2.0}),
        ({"names": ["rail"], "effort": [3.0]}, {"rail": 3.0}),
        ({"names": ["rail", "pin"], "effort": [NAN, 0.0]}, {"pin": 0.0}),
        ({"names": ["pin"], "position": [NAN], "velocity": [NAN], "effort": [4.0]}, {"pin": 4.0}),
        ({"names": ["pin"]}, {}),
        ({}, {}),
    ],
)
def test_a_message_commands_some_of_the_joints(layout, fields, efforts):
    reader = JointCommandInput(layout, 0.02)
    found = reader.read(message(**fields), NOW, 0, None)
    assert {command.name: command.values[0] for command in found} == efforts
    assert reader.accepted == 1 and not any(reader.refused.values())


def test_positions_and_velocities_are_targets_of_servos(layout):
    reader = JointCommandInput(layout, 0.02)
    for fields, target in (
        ({"names": ["pin"], "position": [2.0], "velocity": [3.0]}, ("pin", 2.0, 3.0)),
        ({"names": ["rail", "pin"], "position": [NAN, 2.0], "effort": [1.0, NAN]}, ("pin", 2.0, 0.0)),
    ):
        *efforts, found = reader.read(message(**fields, stamp_ns=NOW + 5), NOW, 0, None)
        assert found == Command(TARGET, target[0], target[1:], NOW + 5)
        assert [effort.name for effort in efforts] == ["rail"] * len(efforts)
    free = scene_from_text(SCENE.replace("stiffness: 9", "stiffness: 0"))
    (found,) = JointCommandInput(make_layout(free), 0.02).read(message(["pin"], velocity=[3.0]), NOW, 0, None)
    assert found == Command(TARGET, "pin", (0.0, 3.0))


def test_a_servo_that_a_law_leads_takes_no_target():
    scene = scene_from_text(SCENE)
    (servo,) = [force for force in scene.forces if force.type == "servo"]
    lead = {"type": "law", "name": "lead", "outputs": [{"servo": servo.name, "position": "sin(t)"}]}
    reader = JointCommandInput(make_layout(scene.remade(forces=[*scene.forces, lead])), 0.02)
    with pytest.raises(Refusal, match="pin follows the law lead, whose output is the target of its servo"):
        reader.read(message(["pin"], position=[1.0]), NOW, 0, None)
    (found,) = reader.read(message(["pin"], effort=[1.0]), NOW, 0, None)
    assert found.kind == EFFORT


@pytest.mark.parametrize(
    "stamp_ns, start_ns", [(0, None), (NOW - 1, None), (NOW, None), (NOW + 1, NOW + 1), (NOW - 10**9, None)]
)
def test_a_future_stamp_is_awaited(layout, stamp_ns, start_ns):
    payload = message(["pin"], effort=[1.0], stamp_ns=stamp_ns)
    (command,) = JointCommandInput(layout, 0.02).read(payload, NOW, 0, None)
    assert command.start_ns == start_ns


@pytest.mark.parametrize("stamp_ns", [1, NOW + 1, NOW + 2 * FARTHEST])
def test_stamps_of_another_clock_can_be_ignored(layout, stamp_ns):
    payload = message(["pin"], effort=[1.0], stamp_ns=stamp_ns)
    (command,) = JointCommandInput(layout, 0.02).read(payload, 10 * NOW, 0, 0.1, stamped=False)
    assert command.start_ns is None


@pytest.mark.parametrize(
    "changed, reason",
    [
        ({"effort": [math.inf, 0.0]}, "not_finite"),
        ({"position": [NAN, -math.inf]}, "not_finite"),
        ({"effort": [1.0]}, "wrong_length"),
        ({"effort": [1.0] * 3}, "wrong_length"),
        ({"names": [], "effort": [1.0]}, "wrong_length"),
        ({"velocity": [NAN]}, "wrong_length"),
        ({"names": ["pin", "rial"]}, "unknown_joint"),
        ({"names": ["pin", ""]}, "unknown_joint"),
        ({"names": ["ball"], "effort": [1.0]}, "no_coordinate"),
        ({"names": ["pin", "pin"]}, "repeated_joint"),
        ({"names": ["pin"] * 9, "effort": [1.0] * 9}, "damaged"),
        ({"position": [0.0, 0.0]}, "no_servo"),
        ({"velocity": [NAN, 0.0]}, "no_servo"),
        ({"velocity": [0.0, NAN]}, "no_position"),
        ({"stamp_ns": NOW - 10**9 - 1}, "stamp_too_old"),
        ({"stamp_ns": NOW - 10**8 - 1, "lasting": 0.1}, "stamp_too_old"),
        ({"stamp_ns": -1}, "stamp_too_old"),
        ({"stamp_ns": NOW + FARTHEST + 1}, "stamp_too_far"),
        ({"held": MOST}, "too_many"),
    ],
)
def test_refusals_are_one_line(layout, changed, reason):
    more = {"held": 0, "lasting": None}
    more |= {key: changed[key] for key in more.keys() & changed.keys()}
    fields = {"names": ["pin", "rail"], "effort": [1.0, 2.0]}
    fields |= {key: value for key, value in changed.items() if key not in more}
    reader = JointCommandInput(layout, 0.02)
    with pytest.raises(Refusal) as caught:
        reader.read(message(**fields), NOW, more["held"], more["lasting"])
    assert caught.value.reason == reason and caught.value.is_told
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 300
    assert reader.accepted == 0 and reader.refused[reason] == 1


def test_positions_far_from_their_joint_are_refused(layout):
    """From the present position; velocities, efforts and joints without a position have no limit."""
    reader, jumps = JointCommandInput(layout, 0.02), Jumps(0.25, {"pin": 7.0, "rail": 0.0}, 0.002)
    taken = message(["pin", "rail"], [7.25, NAN], [90.0, NAN], [0.0, 99.0])
    assert len(reader.read(taken, NOW, 0, None, jumps=jumps)) == 3
    for position in (7.2501, 6.7499, 7.0 - 2.0 * math.pi):
        with pytest.raises(Refusal) as caught:
            reader.read(message(["pin"], [position]), NOW, 0, None, jumps=jumps)
        assert caught.value.reason == "jump_too_large" and len(str(caught.value)) < 300
    assert "it moves pin from 7 to 7.2501 rad, by more than 0.25 rad at once" in first_refusal(
        layout, message(["pin"], [7.2501]), jumps
    )
    assert (reader.accepted, reader.refused["jump_too_large"]) == (1, 3)
    assert reader.read(message(["pin"], [-99.0]), NOW, 0, None)


def first_refusal(layout, payload, jumps):
    with pytest.raises(Refusal) as caught:
        JointCommandInput(layout, 0.02).read(payload, NOW, 0, None, jumps=jumps)
    return str(caught.value)


def test_joints_of_a_robot_have_the_names_of_its_file(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(ARM_URDF.replace('"shoulder"', '"shoulder-1"'))
    layout = make_layout(load_scene(path))
    (scene_name,) = set(layout.coordinates.names) - {"extend"}
    reader = JointCommandInput(layout, 0.02)
    found = reader.read(message(["extend", "shoulder-1"], effort=[1.0, 2.0]), NOW, 0, None)
    assert [(c.name, *c.values) for c in found] == [("extend", 1.0), (scene_name, 2.0)]
    assert scene_name != "shoulder-1"
    for name, reason in (("tip_joint", "no_coordinate"), ("flange", "unknown_joint"), (scene_name, "unknown_joint")):
        with pytest.raises(Refusal) as caught:
            reader.read(message([name], effort=[1.0]), NOW, 0, None)
        assert caught.value.reason == reason


@given(
    st.lists(
        st.tuples(
            st.lists(st.text("ab", max_size=9), max_size=4),
            *(st.lists(st.floats(), max_size=4) for _ in range(3)),
            st.integers(0, 2 * 10**18),
        ),
        min_size=1,
        max_size=4,
    )
)
def test_messages_serialized_by_ros_are_decoded(messages):
    """Also those with the names of the last one, which are not decoded again."""
    decoder = JointStateDecoder()
    for names, *values, stamp_ns in [*messages, messages[-1]]:
        found = decoder.decode(message(names, *values, stamp_ns))
        assert (found.stamp_ns, found.names) == (stamp_ns, tuple(names))
        assert repr(list(map(list, found[2:]))) == repr(values)


@given(st.binary(max_size=200), st.booleans())
def test_arbitrary_bytes_do_not_crash_the_decoder(payload, known):
    decoder = JointStateDecoder(5)
    whole = message(["pin"], effort=[1.0])
    if known:
        decoder.decode(whole)
    for start in (b"", b"\0\1\0\0", whole[: len(whole) // 2]):
        try:
            decoder.decode(start + payload)
        except MessageError as error:
            assert "\n" not in str(error)


def test_truncated_messages_are_refused_whatever_came_before(layout):
    whole = message(["pin", "rail"], effort=[1.0, 2.0])
    reader = JointCommandInput(layout, 0.02)
    reader.read(whole, NOW, 0, None)
    for size in range(len(whole) - 8):
        with pytest.raises(Refusal):
            reader.read(whole[:size], NOW, 0, None)
    assert reader.refused["damaged"] == len(whole) - 8


SCREW = text_of("vice.yaml")


def test_a_screw_takes_the_commands_of_a_joint_with_one_coordinate():
    """In rad and N m about its axis; one that is not driven takes efforts."""
    reader = JointCommandInput(make_layout(scene_from_text(SCREW)), 0.02)
    (motion,) = reader.read(message(["thread"], [3.0], [0.5]), NOW, 0, None)
    assert motion == Command(MOVE, "thread", (3.0, 0.5, 0.02))
    (effort,) = reader.read(message(["other"], effort=[1.5]), NOW, 0, None)
    assert (effort.name, *effort.values) == ("other", 1.5)
    for payload, reason in (
        (message(["other"], [1.0]), "no_servo"),
        (message(["thread"], [4.1]), "beyond_limits"),
        (message(["thread"], velocity=[1001.0]), "beyond_limits"),
    ):
        with pytest.raises(Refusal) as caught:
            reader.read(payload, NOW, 0, None)
        assert caught.value.reason == reason and "\n" not in str(caught.value)
    assert reader.accepted == 2


# Inputs that wait for the simulation thread: what is replaced is counted, what is too late refused.


INBOX_SCENE = text_of("rig_inbox.yaml")


@pytest.fixture
def simulation():
    return Simulation(scene_from_text(INBOX_SCENE), "rkmk8", 1e-3)


def test_what_never_acts_is_counted(simulation):
    inbox, refused = Inbox(simulation, 2e-3, 0.02, lambda: None), []
    for value in (1.0, 2.0, 3.0):
        inbox.push([Command(MOVE, "free", (value, 0.0, 0.05))], None, refused.append)
    assert (len(inbox), inbox.replaced) == (1, 2)
    for _ in range(2):
        inbox.follow(Waypoints(["free"], [Point((0.1,), (), (), (), 10**9)]), refused.append)
    assert inbox.replaced == 3
    inbox.discard()
    assert (len(inbox), inbox.replaced) == (0, 5)
    inbox.deliver(0, 0.0)
    assert simulation.input_count == 0 and not refused


def test_a_command_that_cannot_be_followed_when_it_starts_is_refused(simulation):
    """It was within the limits from where the joint was when it arrived."""
    inbox, refused = Inbox(simulation, 2e-3, 0.02, lambda: None), []
    inbox.push([Command(MOVE, "free", (18.0, 0.0, 0.02))], None, refused.append)
    inbox.push([Command(MOVE, "thread", (0.5, 0.0, 0.02))], None, refused.append)
    inbox.deliver(0, 0.0)
    assert len(refused) == 1 and "'free' would need 1687.5 rad/s" in refused[0]
    far = [Point((0.2, 1e9), (), (), (), 10**9)]
    inbox.follow(Waypoints(["thread", "free"], far), refused.append)
    inbox.deliver(0, 0.01)
    assert len(refused) == 2 and "'free' would need" in refused[1]
    simulation.advance(2000)
    found = {joint: motion[0] for joint, motion in simulation.sample().prescribed.items()}
    assert found["free"] == 0.0
    assert found["thread"] == pytest.approx(0.5, abs=1e-12)


def test_an_effort_is_delivered(simulation):
    inbox = Inbox(simulation, 2e-3, 0.02, lambda: None)
    inbox.push([Command(EFFORT, "free", (3.0,), source="a")], None)
    inbox.deliver(0, 0.0)
    simulation.advance(1)
    assert simulation.sample().joint_efforts == {"free": 3.0} and math.isfinite(simulation.energy())
