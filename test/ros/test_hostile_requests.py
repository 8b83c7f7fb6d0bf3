# SPDX-License-Identifier: Apache-2.0
"""Random requests to every service and topic of a node: none ends it, freezes it or runs code."""

import array
import importlib
import os
import re
import signal
from pathlib import Path

import numpy as np
import pytest
from hostile import Messages, texts, xacro_text
from node_process import UNDISCOVERED, NodeProcess
from scene_files import text_of
from volume import VERIFY

from liegroup_core.scene.library import chain
from liegroup_sim_ros.recording.read import read_recording

NODE = "/besieged"
SCENE = text_of("besieged.yaml")
NAMES = ("arm", "stone", "hinge", "arm/pose", "arm/twist", "hinge/position", "hinge/velocity", "body")
NAMES += ("duration", "force", "point", "scene", "record", "snapshot", "step_count", "real_time_factor")
REQUESTS = 30 if VERIFY else 5  # to each service
MESSAGES = 60 if VERIFY else 20  # to each topic
FROZEN = 10.0  # s of CPU time of the node; far above the 2 ms that an answer takes
MEMORY = 2**20  # kB
# Types of messages that may have any length, and their fields of numbers.
LONG = {"sensor_msgs/msg/JointState": "position", "std_msgs/msg/Float64MultiArray": "data"}
QUIT = 3  # state of a simulation that ends the node


@pytest.fixture(scope="module")
def besieged(client, package, tmp_path_factory):
    """(NodeProcess, folder): a node that records, with a canary that nothing must make."""
    folder = tmp_path_factory.mktemp("besieged")
    (folder / "scene.yaml").write_text(SCENE)
    code = "${[c for c in ().__class__.__base__.__subclasses__()]}"
    (folder / "canary.xacro").write_text(xacro_text(code))
    parameters = {"scene": folder / "scene.yaml", "record": folder / "run.mcap"}
    parameters |= {"method": "rkmk4", "command_joints": "hinge", "world_folders": folder}
    with NodeProcess(parameters, [f"__node:={NODE[1:]}"], package) as process:
        assert client.call(f"{NODE}/pause").success
        yield process, folder


def most_memory(process):
    status = Path(f"/proc/{process.process.pid}/status").read_text()
    return int(re.search(r"VmHWM:\s+(\d+) kB", status)[1])


def of_type(text):
    """Class of a type such as std_srvs/srv/Trigger, or of a service of an action."""
    package, kind, name = text.split("/")
    if kind == "action":
        action, _, part = name.rpartition("_")
        module = importlib.import_module(f"{package}.action")
        return getattr(getattr(module, action).Impl, f"{part}Service")
    return getattr(importlib.import_module(f"{package}.{kind}"), name)


def cpu_seconds(process):
    """CPU time of a node: unlike wall time, it does not depend on other processes."""
    user, system = Path(f"/proc/{process.process.pid}/stat").read_text().rpartition(")")[2].split()[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def call(client, process, name, *request):
    """Call a service; the node must answer, and not be held up by it."""
    before = cpu_seconds(process)
    client.call(name, *request, again=UNDISCOVERED)
    assert cpu_seconds(process) - before < FROZEN, (name, request)


def discovered(client, ask, least):
    """[(name, types)] of services or topics of the node, when there are more than `least`."""

    def found():
        known = NODE[1:] in client.node.get_node_names() and ask(NODE[1:], "/")
        return known if known and len(known) > least else None

    return client.until(found, "discovery")


def test_no_request_ends_or_freezes_the_node(client, besieged):
    process, folder = besieged
    messages = Messages(np.random.default_rng(11), texts(folder / "canary", NAMES))
    services = discovered(client, client.node.get_service_names_and_types_by_node, 15)
    memory = most_memory(process)
    for name, (kind, *_) in services:
        service = of_type(kind)
        for _ in range(REQUESTS):
            request = messages.of(service.Request)
            if name.endswith("set_simulation_state") and request.state.state == QUIT:
                continue
            if name.endswith("get_type_description"):  # rcl logs it all; nobody reads the pipe yet
                request.type_hash = request.type_hash[:60]
            if name.endswith("send_goal"):
                request.goal.steps = min(request.goal.steps, 9)  # others go on until they are cancelled
            call(client, process, name, service, request)
        call(client, process, f"{NODE}/pause")  # it is still the same one
    assert most_memory(process) - memory < MEMORY
    assert not (folder / "canary").exists()


def test_no_message_ends_or_freezes_the_node(client, besieged):
    process, folder = besieged
    messages = Messages(np.random.default_rng(12), texts(folder / "canary", NAMES))
    topics = [
        (name, kinds[0])
        for name, kinds in discovered(client, client.node.get_subscriber_names_and_types_by_node, 5)
        if name.startswith(NODE)
    ]
    assert len(topics) >= 6
    memory = most_memory(process)
    for name, kind in topics:
        publisher = client.node.create_publisher(of_type(kind), name, 100)
        client.until(publisher.get_subscription_count)
        for _ in range(MESSAGES):
            publisher.publish(messages.of(of_type(kind)))
        call(client, process, f"{NODE}/pause")
        if kind in LONG:
            message = of_type(kind)()
            setattr(message, LONG[kind], array.array("d", [0.0]) * 1_000_000)
            for _ in range(40):
                publisher.publish(message)
            call(client, process, f"{NODE}/pause")
    assert most_memory(process) - memory < MEMORY
    assert not (folder / "canary").exists()


@pytest.mark.parametrize(
    "uri, code",
    [
        ("http://[", 101),
        ("/proc/self/mem", 2),
        ("file:///etc/passwd", 2),
        ("../" * 20 + "etc/passwd", 2),
        ("x" * 5000, 2),
        ("canary.xacro", 103),
    ],
)
def test_a_world_that_is_refused_has_its_code(uri, code, client, besieged):
    from simulation_interfaces.srv import LoadWorld

    process, folder = besieged
    request = LoadWorld.Request(uri=uri if "/" in uri or len(uri) > 99 else f"{folder}/{uri}")
    response = client.call(f"{NODE}/load_world", LoadWorld, request)
    assert response.result.result == code, response.result.error_message
    assert response.result.error_message and "\n" not in response.result.error_message


def test_worlds_are_bounded(client, besieged):
    """Topics of 300 bodies would hold up the node, as would a search for a million files."""
    from simulation_interfaces.srv import GetAvailableWorlds, LoadWorld

    bodies = "".join(f"  - {{name: b{k}, mass: 1, inertia: [1, 1, 1]}}\n" for k in range(300))
    text = f"name: many\ngravity: [0, 0, 0]\nbodies:\n{bodies}"
    answer = client.call(f"{NODE}/load_world", LoadWorld, LoadWorld.Request(resource_string=text))
    assert answer.result.result == 4 and "at most 200" in answer.result.error_message
    request = GetAvailableWorlds.Request(additional_sources=[f"a{k}" for k in range(101)])
    answer = client.call(f"{NODE}/get_available_worlds", GetAvailableWorlds, request)
    assert answer.result.result == 4 and "at most 100" in answer.result.error_message


def test_a_parameter_names_no_file_elsewhere(client, besieged):
    process, folder = besieged
    for path, reason in (("/etc/passwd", "is not read"), (f"{folder}/canary.xacro", "not allowed")):
        assert client.set(NODE, scene=path).successful
        answer = client.call(f"{NODE}/reload")
        assert not answer.success and reason in answer.message, answer.message
    assert client.set(NODE, scene=str(folder / "scene.yaml")).successful


def test_huge_numbers_are_refused_before_they_count(client, besieged):
    from rcl_interfaces.srv import SetParametersAtomically
    from rclpy.parameter import Parameter

    for name, value in (("hinge/velocity", 1e308), ("stone/twist", [1e300] + [0.0] * 5)):
        request = SetParametersAtomically.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        result = client.call(f"{NODE}/set_state", SetParametersAtomically, request).result
        assert not result.successful and "finite number" in result.reason, result.reason


def test_a_filter_is_matched_in_linear_time(client, besieged):
    from simulation_interfaces.srv import GetEntities

    request = GetEntities.Request()
    request.filters.filter = r"(\w+)+!"
    response = client.call(f"{NODE}/get_entities", GetEntities, request)
    assert response.result.result == 1 and list(response.entities) == []
    request.filters.filter = "st.*|x"
    found = client.call(f"{NODE}/get_entities", GetEntities, request)
    assert list(found.entities) == ["stone"]


def test_other_requests_are_answered_while_steps_are_taken(client, besieged):
    """A million steps of 4 us and the messages of them take seconds."""
    from simulation_interfaces.srv import StepSimulation

    client.call(f"{NODE}/pause")
    stepping = client.node.create_client(StepSimulation, f"{NODE}/step_simulation")
    client.until(stepping.service_is_ready)
    before = cpu_seconds(besieged[0])
    future = stepping.call_async(StepSimulation.Request(steps=1_000_000))
    client.until(lambda: cpu_seconds(besieged[0]) > before + 0.2, "the beginning of the steps")
    client.call(f"{NODE}/pause")
    assert not future.done()
    assert client.call(f"{NODE}/resume").success
    client.until(future.done)
    assert "stopped after" in future.result().result.error_message
    assert client.call(f"{NODE}/pause").success


@pytest.mark.parametrize(
    "number, more",
    [
        # Ticks without an end: of 1e9 steps; a step of 600 links, where a body that tumbles at 1e6 rad/s makes
        # substeps short, at least 1e6 of them of 1 ms.
        (signal.SIGINT, {"scene": "heavy_top", "method": "rkmk4", "step": 1e-8, "estimate": False}),
        (signal.SIGHUP, {"scene": "links.yaml", "method": "rkmk853", "step": 10.0}),
    ],
)
def test_a_signal_ends_a_node_in_the_middle_of_a_long_tick(number, more, client, tmp_path):
    rates = {f"{name}_rate": 0.0 for name in ("state", "clock", "marker", "joint_state")}
    rates |= {"publish_rate": 0.1, "real_time_factor": 0.0}
    record = tmp_path / "run.mcap"
    if more["scene"] == "links.yaml":
        body = "- {name: tumbles, mass: 1, inertia: [0.1, 0.2, 0.25], angular_velocity: [1.0e+6, 1.0e+6, 0]}\n"
        (tmp_path / "links.yaml").write_text(chain(600).text.replace("\nbodies:\n", f"\nbodies:\n{body}"))
        more = more | {"scene": tmp_path / "links.yaml"}
    events = client.events("/long")
    with NodeProcess(more | rates | {"record": record}, ["__node:=long"]) as process:
        client.until(lambda: events, "the start")
        before = cpu_seconds(process)
        client.until(lambda: cpu_seconds(process) > before + 0.3, "the tick")
        errors = process.end(number)
    assert "recorded" in errors, errors
    recording = read_recording(record)
    # The tick is at 10 s: none of its messages has been sent.
    assert recording.complete and recording.last_ns < 10 * 10**9
    assert [event.name for event in recording.events] == ["start", "stop"]


def test_the_node_ends_and_has_recorded_all_that_it_says(client, besieged):
    process, folder = besieged
    errors = process.end(signal.SIGQUIT)
    recorded = sum(map(int, re.findall(r"recorded (\d+) message", errors)))
    parts = [read_recording(path) for path in sorted(folder.glob("run*.mcap"))]
    assert all(part.complete for part in parts)
    assert recorded == sum(sum(part.topics.values()) for part in parts) > 0
    assert not (folder / "canary").exists()
