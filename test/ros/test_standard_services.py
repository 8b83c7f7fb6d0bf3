# SPDX-License-Identifier: Apache-2.0
"""Services and the action of simulation_interfaces, over DDS, with messages of the package's types.

The package is not on PyPI. If it is not installed, it is built from its fields by the generators of
rosidl; the type hashes are those of its own files.
"""

import re
from pathlib import Path

import numpy as np
import pytest
import simulation_interfaces_types as types
from interface_package import hashes, missing
from node_process import NodeProcess, output_of, path_with, python
from rclpy.qos import QoSProfile
from scene_files import text_of

from liegroup_core import load_scene
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.node import standard_services
from liegroup_sim_ros.recording.read import read_recording

NODE = "/standard"
STOPPED, PLAYING, PAUSED, QUITTING = range(4)
# A pendulum about y, horizontal along x at the start, and a free body whose mass is off its origin.
SCENE = text_of("rig_standard_services.yaml")
FALL = 2.0 * 10.0 * 1.0 / (3.0 + 2.0 * 1.0**2)  # rad/s^2 about y: m g l / (I + m l^2)


class Node:
    """A simulation node, and calls of its services."""

    def __init__(self, client, srv):
        self._client, self._srv = client, srv

    def __call__(self, service, **fields):
        """(number of the result, response); `a__b` sets the field b of the field a."""
        kind = getattr(self._srv, "".join(part.capitalize() for part in service.split("_")))
        request = kind.Request()
        for path, value in fields.items():
            *parts, last = path.split("__")
            target = request
            for part in parts:
                target = getattr(target, part)
            setattr(target, last, value)
        response = self._client.call(f"{NODE}/{service}", kind, request)
        return getattr(getattr(response, "result", None), "result", None), response

    def state(self):
        result, response = self("get_simulation_state")
        assert result == 1
        return response.state.state

    def go(self, state):
        result, response = self("set_simulation_state", state__state=state)
        return result, response.result.error_message

    def entity(self, name):
        result, response = self("get_entity_state", entity=name)
        assert result == 1, response.result.error_message
        return response.state

    def stamp_ns(self):
        stamp = self.entity("stone").header.stamp
        return stamp.sec * 10**9 + stamp.nanosec


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("standard")
    (folder / "rig.yaml").write_text(SCENE)
    return folder


@pytest.fixture(scope="module")
def process(client, package, srv, files):
    parameters = {
        "scene": files / "rig.yaml",
        "method": "rkmk4",
        "start_paused": True,
        "record": files / "run.mcap",
        "publish_rate": 1000.0,
    }
    with NodeProcess(parameters, [f"__node:={NODE[1:]}"], package) as process:
        yield process


@pytest.fixture
def node(client, process, srv):
    """The node with the scene rig, stopped."""
    node = Node(client, srv)
    _, response = node("get_current_world")
    if response.world.name != "rig":
        assert client.call(f"{NODE}/reload").success
    if node.state() != STOPPED:
        assert node.go(STOPPED)[0] == 1
    return node


def vector(message, names="xyz"):
    return [getattr(message, name) for name in names]


@pytest.mark.parametrize(
    "fields, expected",
    [(types.JAZZY, types.JAZZY_HASHES), (types.LATEST, types.LATEST_HASHES)],
    ids=["jazzy", "latest"],
)
@pytest.mark.volume(1)
def test_the_types_are_those_of_the_package(request, fields, expected):
    if missing():
        pytest.skip(f"{missing()} is missing")
    folder = types.package(fields, request.config.cache.mkdir("interfaces"))
    assert hashes(folder) == {name: f"RIHS01_{value}" for name, value in expected.items()}


def test_the_page_lists_all_services_with_their_types():
    page = (Path(__file__).parents[2] / "docs" / "reference" / "node.md").read_text()
    table = page.split("## simulation_interfaces")[1].split("## ")[0]
    listed = {}
    for line in table.splitlines():
        names, kinds, *_ = [*line.strip("| ").split(" | "), ""]
        listed |= dict(zip(re.findall(r"`~/(\w+)`", names), kinds.split(", ")))
    expected = {name: kind for name, (kind, _) in standard_services.SERVICES.items()}
    assert listed == expected | {standard_services.ACTION: "SimulateSteps"}
    offered = {name.partition("/")[2] for name in types.JAZZY if not name.startswith("msg/")}
    assert offered == set(listed.values())


def test_the_features_are_those_of_the_services(node):
    _, response = node("get_simulator_features")
    features = response.features
    assert list(features.features) == [
        *(10, 11),  # state of entities: get, set
        *(20, 22, 24, 25, 26),  # reset, of the state; simulation state: get, set, pause
        *(31, 32, 33),  # one step, several, action
        *(40, 41, 44, 45),  # worlds: load, from a text, current, available
    ]
    assert list(features.spawn_formats) == [] and "liegroup_sim_ros" in features.custom_info


def test_states_and_steps(node):
    assert node.state() == STOPPED
    result, text = node.go(PAUSED)
    assert result == 103 and "stopped" in text  # incorrect transition
    assert node.go(STOPPED)[0] == 101  # already there
    before = node.stamp_ns()
    assert node("step_simulation", steps=7)[0] == 1 and node.state() == PAUSED
    assert node.stamp_ns() == before + 7_000_000
    assert node("step_simulation")[0] == 1  # the default of the type: one step
    assert node.stamp_ns() == before + 8_000_000
    assert node.go(PLAYING)[0] == 1 and node.state() == PLAYING
    assert node.go(PLAYING)[0] == 101
    result, response = node("step_simulation", steps=1)
    assert result == 4 and "~/pause first" in response.result.error_message
    assert node.go(PAUSED)[0] == 1 and node.state() == PAUSED
    result, response = node("step_simulation", steps=10**9)
    assert result == 4 and "at most 1000000" in response.result.error_message
    assert node.go(STOPPED)[0] == 1 and node.state() == STOPPED
    for state in (4, 5, 77):
        result, text = node.go(state)
        assert result == 0 and f"state {state} cannot be set" in text
    assert node.state() == STOPPED


def test_reset_restores_the_state_but_not_the_time(node):
    node("step_simulation", steps=5)
    for scope in (1, 3, 4):
        result, response = node("reset_simulation", scope=scope)
        assert result == 0 and f"scope {scope}: " in response.result.error_message
    for scope in (0, 2, 6, 255):
        assert node("step_simulation", steps=5)[0] == 1
        before = node.stamp_ns()
        assert node("reset_simulation", scope=scope)[0] == 1
        assert node.stamp_ns() == before + 1_000_000 and node.state() == STOPPED


def test_entities_are_bodies(node):
    def entities(**filters):
        fields = {f"filters__{name}": value for name, value in filters.items()}
        result, response = node("get_entities", **fields)
        states_result, states = node("get_entities_states", **fields)
        assert (result, list(response.entities)) == (states_result, list(states.entities))
        assert len(states.states) == len(states.entities)
        return result, list(response.entities)

    from simulation_interfaces.msg import EntityCategory

    assert entities() == (1, ["arm", "stone"])
    assert entities(filter="a.*") == (1, ["arm"])
    assert entities(filter="a") == (1, [])  # the whole name
    assert entities(filter="(") == (4, [])
    assert entities(categories=[EntityCategory()]) == (0, [])
    assert entities(tags__tags=["x"]) == (0, [])
    assert entities(bounds__type=3) == (0, [])
    result, response = node("get_entity_state", entity="leg")
    assert result == 2 and "'leg'" in response.result.error_message


def test_states_of_entities_are_in_world_axes(node):
    stone, arm = node.entity("stone"), node.entity("arm")
    assert stone.header.frame_id == arm.header.frame_id == "world"
    assert vector(stone.pose.position) == [5.0, 6.0, 7.0]
    half = np.sqrt(0.5)
    assert vector(stone.pose.orientation, "xyzw") == pytest.approx([0, 0, half, half])
    # A quarter turn about z: body x is world y.
    assert vector(stone.twist.angular) == pytest.approx([0, 2, 0], abs=1e-15)
    assert vector(stone.twist.linear) == pytest.approx([0, 1, 0], abs=1e-15)
    # The centre of mass falls; it is above the origin, which circles about it at 2 rad/s.
    assert vector(stone.acceleration.angular) == pytest.approx([0, 0, 0], abs=1e-12)
    assert vector(stone.acceleration.linear) == pytest.approx([0, 0, -10 + 4], abs=1e-12)
    assert vector(arm.acceleration.angular) == pytest.approx([0, FALL, 0], abs=1e-12)
    assert vector(arm.acceleration.linear) == pytest.approx([0, 0, 0], abs=1e-12)


def test_accelerations_contain_applied_wrenches(client, node):
    push = client.pusher(NODE, "wrench/persistent")
    push("arm", torque=(0.0, 5.0, 0.0))
    client.until(
        lambda: (
            node("step_simulation", steps=1)[0] == 1
            and abs(node.entity("arm").acceleration.angular.y - FALL - 1.0) < 0.01
        )
    )


def test_a_state_that_is_set_is_kept_and_recorded(client, node):
    node("step_simulation", steps=20)
    before = node.stamp_ns()
    state = node.entity("stone")
    state.pose.position.x, state.pose.position.z = -3.0, 2.5
    state.pose.orientation.x, state.pose.orientation.y = 0.0, 0.0
    state.pose.orientation.z, state.pose.orientation.w = 0.0, 1.0005  # within single precision
    state.twist.linear.x, state.twist.angular.z = 0.25, -1.0
    arm = node.entity("arm")
    result, response = node("set_entity_state", entity="stone", state=state)
    assert result == 1 and "pose and twist of stone" in response.result.error_message
    assert node.stamp_ns() == before + 1_000_000 and node.state() == PAUSED
    found = node.entity("stone")
    assert vector(found.pose.position) == vector(state.pose.position)
    assert vector(found.pose.orientation, "xyzw") == [0.0, 0.0, 0.0, 1.0]
    assert vector(found.twist.linear) == pytest.approx(vector(state.twist.linear), abs=1e-15)
    assert vector(found.twist.angular) == pytest.approx(vector(state.twist.angular), abs=1e-15)
    assert vector(node.entity("arm").pose.orientation, "xyzw") == vector(arm.pose.orientation, "xyzw")
    # A pose that the hinge allows, with the twist of this instant.
    arm.pose.orientation.y, arm.pose.orientation.w = np.sin(0.4), np.cos(0.4)
    assert node("set_entity_state", entity="arm", state=arm)[0] == 1
    assert node("step_simulation", steps=30)[0] == 1


def test_a_state_that_the_joints_do_not_allow_is_refused(node):
    node("step_simulation", steps=3)
    before = node.entity("arm")

    def refused(code, text, entity="arm", **changes):
        state = node.entity("arm")
        for path, value in changes.items():
            *parts, last = path.split("__")
            target = state
            for part in parts:
                target = getattr(target, part)
            setattr(target, last, value)
        result, response = node("set_entity_state", entity=entity, state=state)
        assert result == code and text in response.result.error_message, response
        assert "\n" not in response.result.error_message

    refused(101, '"hinge": cannot be assembled, the remaining constraint violation is 0.5 m', pose__position__z=0.5)
    refused(101, "has norm ", pose__orientation__w=0.0)
    refused(101, "has norm nan", pose__orientation__w=float("nan"))
    refused(101, "position is not finite", pose__position__x=float("inf"))
    refused(4, "violates this joint by 2 m/s", twist__linear__x=2.0)
    refused(4, "twist is not finite", twist__angular__x=float("nan"))
    refused(0, "frame_id 'stone'", header__frame_id="stone")
    refused(2, "unknown entity 'leg'", entity="leg")
    assert node.entity("arm") == before


def test_worlds_are_scenes(client, node, files):
    _, response = node("get_current_world")
    world = response.world
    assert (world.name, world.description) == ("rig", "pendulum and stone")
    assert world.world_resource.uri == str(files / "rig.yaml")
    result, response = node("get_available_worlds", additional_sources=[files.as_uri()])
    known = {world.name: world.world_resource.uri for world in response.worlds}
    assert result == 1 and {"heavy_top", "four_bar", "rig"} <= known.keys()
    assert load_scene(known["four_bar"]).name == "four_bar"
    for world in response.worlds:
        assert world.description == load_scene(world.world_resource.uri).description.strip()
    result, response = node("get_available_worlds", additional_sources=["/no/such/folder"])
    assert result == 2 and "/no/such/folder" in response.result.error_message
    result, _ = node("get_available_worlds", additional_sources=["/no/such/folder"], continue_on_error=True)
    assert result == 1
    assert node("get_available_worlds", filter__tags=["indoor"])[0] == 0


def load(node, uri="", text="", **more):
    """(result, error, world) of load_world, of any version of its type."""
    request = node._srv.LoadWorld.Request()
    prefix = "world_resource__" if hasattr(request, "world_resource") else ""
    fields = {f"{prefix}uri": uri, f"{prefix}resource_string": text}
    result, response = node("load_world", **fields, **more)
    return result, response.result.error_message, response.world


def test_a_world_is_loaded_and_stopped(client, node, files):
    assert node.go(PLAYING)[0] == 1
    result, _, world = load(node, "double_pendulum")
    assert result == 1 and world.name == "double_pendulum" and node.state() == STOPPED
    assert list(node("get_entities")[1].entities) == ["upper", "lower"]
    assert client.call(f"{NODE}/reload").message.startswith("double_pendulum ")
    result, _, world = load(node, text=SCENE.replace("name: rig", "name: text"))
    assert result == 1 and (world.name, world.world_resource.uri) == ("text", "")
    assert load_text(world) == "text" and node.state() == STOPPED
    assert load(node, (files / "rig.yaml").as_uri())[0] == 1
    assert node("get_current_world")[1].world.name == "rig"


def load_text(world):
    from liegroup_core.scene.load import scene_from_text

    return scene_from_text(world.world_resource.resource_string).name


def test_a_world_that_cannot_be_loaded_is_refused_and_the_previous_one_continues(node, files):
    (files / "wrong.yaml").write_text(SCENE.replace("mass: 2", "mass: -2"))
    (files / "world.usd").write_text("#usda 1.0")
    before = node.stamp_ns()
    for code, text, arguments in (
        (102, "both empty", {}),
        (101, "https://host/a.yaml: cannot be read", {"uri": "https://host/a.yaml"}),
        (101, "is neither a scene file", {"uri": str(files / "world.usd")}),
        (101, "resource_string is XML", {"text": "<robot/>"}),
        (2, "neither a file nor a known scene", {"uri": "heavy_tap"}),
        (103, "mass must be greater than 0, got -2", {"uri": str(files / "wrong.yaml")}),
        (103, "resource_string:1: ", {"text": "bodies: ["}),
    ):
        result, error, world = load(node, **arguments)
        assert result == code and text in error and "\n" not in error, (error, arguments)
        assert world.name == ""
    assert node("get_current_world")[1].world.name == "rig" and node.stamp_ns() == before


def test_a_world_without_its_meshes_is_refused_unless_they_are_ignored(node, files):
    file = files / "mesh.urdf"
    file.write_text(
        '<robot name="shell"><link name="base"/><link name="arm"><inertial><mass value="1"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial><visual><geometry>'
        '<mesh filename="parts/arm.stl"/></geometry></visual></link><joint name="hinge" '
        'type="continuous"><parent link="base"/><child link="arm"/></joint></robot>'
    )
    beside = files / "beside.yaml"
    beside.write_text("robot: mesh.urdf\n")
    before = node.stamp_ns()
    for path in (file, beside):
        result, error, world = load(node, str(path))
        assert result == 104 and world.name == ""
        assert "parts/arm.stl of arm" in error and "\n" not in error
    assert node("get_current_world")[1].world.name == "rig" and node.stamp_ns() == before
    for path in (file, beside):
        result, error, world = load(node, str(path), ignore_missing_or_unsupported_assets=True)
        assert result == 1 and world.world_resource.uri == str(path), error
    (files / "parts").mkdir()
    (files / "parts/arm.stl").write_bytes(b"")
    assert load(node, str(file))[0] == 1
    assert load(node, (files / "rig.yaml").as_uri())[0] == 1


def test_a_robot_whose_mass_follows_from_a_missing_mesh_lacks_an_asset(node, files):
    """It cannot be loaded without: ignored or not, the answer is the same, and names the mesh."""
    path = files / "mass.xml"
    path.write_text(
        '<mujoco model="arm"><asset><mesh name="m" file="nope.stl"/></asset><worldbody>\n'
        '<body name="arm"><joint type="hinge"/><geom type="mesh" mesh="m"/></body>'
        "</worldbody></mujoco>"
    )
    beside = files / "mass.yaml"
    beside.write_text("robot: mass.xml\n")
    for file in (path, beside):
        for ignore in (False, True):
            result, error, world = load(node, str(file), ignore_missing_or_unsupported_assets=ignore)
            assert result == 104 and world.name == "", error
            assert "nope.stl' does not exist" in error and "\n" not in error
    (files / "broken.xml").write_text('<mujoco><worldbody><body name="a"></worldbody></mujoco>')
    assert load(node, str(files / "broken.xml"))[0] == 103  # what cannot be read still is


def send_goal(client, steps):
    """(goal handle, list that grows with the feedback) of the action."""
    from rclpy.action import ActionClient
    from simulation_interfaces.action import SimulateSteps

    actions = ActionClient(
        client.node, SimulateSteps, f"{NODE}/simulate_steps", feedback_sub_qos_profile=QoSProfile(depth=1000)
    )
    client.until(actions.server_is_ready)
    feedback = []
    sent = actions.send_goal_async(
        SimulateSteps.Goal(steps=steps),
        lambda message: feedback.append((message.feedback.completed_steps, message.feedback.remaining_steps)),
    )
    client.until(sent.done)
    assert sent.result().accepted
    return sent.result(), feedback


def outcome(client, goal):
    """(status, result) of a goal."""
    future = goal.get_result_async()
    client.until(future.done)
    return future.result().status, future.result().result.result


SUCCEEDED, CANCELED, ABORTED = 4, 5, 6


def test_the_action_takes_steps_with_feedback(client, node):
    before = node.stamp_ns()
    goal, feedback = send_goal(client, 25)
    client.until(lambda: len(feedback) == 25)
    assert feedback == [(k, 25 - k) for k in range(1, 26)]
    status, result = outcome(client, goal)
    assert (status, result.result, result.error_message) == (SUCCEEDED, 1, "25 steps")
    assert node.stamp_ns() == before + 25_000_000 and node.state() == PAUSED


def test_the_action_is_aborted_while_running_and_can_be_cancelled(client, node):
    assert node.go(PLAYING)[0] == 1
    goal, feedback = send_goal(client, 5)
    status, result = outcome(client, goal)
    assert (status, result.result) == (ABORTED, 4) and "~/pause first" in result.error_message
    assert feedback == [] and node.go(PAUSED)[0] == 1
    before = node.stamp_ns()
    goal, feedback = send_goal(client, 10**12)
    client.until(lambda: len(feedback) > 5)
    cancel = goal.cancel_goal_async()
    client.until(cancel.done)
    status, result = outcome(client, goal)
    done = (node.stamp_ns() - before) // 1_000_000
    assert (status, result.result) == (CANCELED, 4)
    assert result.error_message == f"cancelled after {done} of {10**12} steps"


LATEST = """
import sys
import rclpy
from simulation_interfaces.srv import GetEntityState, LoadWorld, SetEntityState

rclpy.init()
node = rclpy.create_node("user")


def call(kind, name, request):
    client = node.create_client(kind, f"{sys.argv[1]}/{name}")
    assert client.wait_for_service(300.0)
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future, timeout_sec=300.0)
    return future.result()


request = LoadWorld.Request()
request.world_resource.uri = sys.argv[2]
assert call(LoadWorld, "load_world", request).result.result == 1
first = call(GetEntityState, "get_entity_state", GetEntityState.Request(entity="stone")).state
request = SetEntityState.Request(entity="stone", set_pose=True)
request.state.pose.position.x, request.state.pose.orientation.w = 9.0, 1.0
assert call(SetEntityState, "set_entity_state", request).result.result == 1
second = call(GetEntityState, "get_entity_state", GetEntityState.Request(entity="stone")).state
assert second.pose == request.state.pose, second
# The twist in body axes is kept: a quarter turn less about z.
assert abs(second.twist.linear.x - first.twist.linear.y) < 1e-14, (first, second)
request = SetEntityState.Request(entity="stone", set_twist=True)
request.state.twist.linear.z = 4.0
assert call(SetEntityState, "set_entity_state", request).result.result == 1
third = call(GetEntityState, "get_entity_state", GetEntityState.Request(entity="stone")).state
assert third.pose == second.pose and third.twist == request.state.twist, third
request = SetEntityState.Request(entity="stone", set_acceleration=True)
assert call(SetEntityState, "set_entity_state", request).result.result == 0
assert call(SetEntityState, "set_entity_state", SetEntityState.Request(entity="stone")).result.result == 4
"""


@pytest.mark.turn(3)
def test_the_flags_and_resources_of_the_latest_release(request, files):
    if missing():
        pytest.skip(f"{missing()} is missing")
    found = path_with(types.package(types.LATEST, request.config.cache.mkdir("interfaces")))
    parameters = {"scene": "heavy_top", "start_paused": True, "world_folders": str(files)}
    with NodeProcess(parameters, ["__node:=latest"], found):
        user = python(LATEST, "/latest", files / "rig.yaml", env=found)
        output_of(user)


def test_the_recording_of_all_this_is_simulated_again_bit_for_bit(node, process, files, capsys):
    """The last one: states were set, scenes loaded, steps taken."""
    assert node.go(QUITTING)[0] == 1
    code, errors = process.wait()
    assert code == 0 and "Traceback" not in errors, errors
    paths = sorted(files.glob("run*.mcap"))
    recordings = [read_recording(path) for path in paths]
    assert sum(e.name == "state" for r in recordings for e in r.events) == 2
    for path in paths:
        assert main(["replay", str(path), "--resimulate"]) == 0
        assert ": bit-identical in" in capsys.readouterr().out
    # An analysis compares with a reference from every state that was set: errors of the method only.
    assert main(["analyze", str(paths[0]), "--max-error", "1e-9"]) == 0
