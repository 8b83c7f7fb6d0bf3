# SPDX-License-Identifier: Apache-2.0
"""simulation_interfaces services with a real simulation thread.

The package is not needed: its messages are made here from their definitions by rosbags, so fields
that do not exist cannot be set.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from liegroup_core import Simulation
from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.node.simulation_thread import CommandError, SimulationServer
from liegroup_sim_ros.node.standard_services import StandardServices

# Of simulation_interfaces, versions 1.0 to 1.4, without comments.
DEFINITIONS = {
    "Result": "uint8 result\nstring error_message\n",
    "SimulationState": "uint8 state\n",
    "TagsFilter": "string[] tags\nuint8 filter_mode\n",
    "Bounds": "uint8 type\ngeometry_msgs/Vector3[] points\n",
    "EntityCategory": "uint8 category\n",
    "EntityFilters": "string filter\nEntityCategory[] categories\nTagsFilter tags\nBounds bounds\n",
    "EntityState": "std_msgs/Header header\ngeometry_msgs/Pose pose\ngeometry_msgs/Twist twist\n"
    "geometry_msgs/Accel acceleration\n",
    "ResetSimulationRequest": "uint8 scope\n",
    "StepSimulationRequest": "uint64 steps\n",
    "SetSimulationStateRequest": "SimulationState state\n",
    "ResultResponse": "Result result\n",
    "GetSimulationStateResponse": "SimulationState state\nResult result\n",
    "GetEntitiesStatesRequest": "EntityFilters filters\n",
    "GetEntitiesStatesResponse": "Result result\nstring[] entities\nEntityState[] states\n",
}
STOPPED, PLAYING, PAUSED, QUITTING = range(4)
SCENE = """
name: two
gravity: [0, 0, 0]
bodies:
  - {name: arm, mass: 1, inertia: [1, 1, 1], position: [1, 2, 3],
     rotation_vector: [0, 0, 1.5707963267948966], linear_velocity: [1, 0, 0],
     angular_velocity: [0, 2, 0]}
  - {name: leg, mass: 1, inertia: [1, 1, 1]}
"""


class Messages:
    """Message classes of DEFINITIONS with default values, as ROS generates them."""

    def __init__(self):
        self.store = get_typestore(Stores.ROS2_JAZZY)
        for name, text in DEFINITIONS.items():
            self.store.register(get_types_from_msg(text, f"simulation_interfaces/msg/{name}"))

    def make(self, name, package="simulation_interfaces"):
        typename = name if "/" in name else f"{package}/msg/{name}"
        values = {}
        for field, (kind, detail) in self.store.fielddefs[typename][1]:
            if kind.name in ("SEQUENCE", "ARRAY"):
                values[field] = []
            elif kind.name == "NAME":
                values[field] = self.make(detail)
            else:
                values[field] = "" if detail[0] == "string" else 0
        return self.store.types[typename](**values)


class Silent:
    """Simulation outputs that are discarded."""

    timed, clock_steps, state_steps = [], 0, 0

    def __init__(self):
        self.acting, self.targets = {}, {}

    def applied_wrench(self, *_):
        pass

    event = diagnostics = applied_wrench


@pytest.fixture(scope="module")
def messages():
    return Messages()


@pytest.fixture
def services(messages):
    simulation = Simulation(scene_from_text(SCENE, "two"), "rkmk4", 1e-3)
    server = SimulationServer(simulation, Silent(), paused=True)
    server.start()

    def ask(command, *arguments):
        try:
            return True, server.call(command, *arguments).result(10.0)
        except CommandError as error:
            return False, str(error)

    yield StandardServices(
        ask, SimpleNamespace(received=False), "map", lambda: messages.make("EntityState")
    )
    server.stop()
    assert server.failure is None


def call(services, messages, name, response="ResultResponse", **fields):
    """(result, response) of a service call."""
    camel = "".join(part.capitalize() for part in name.split("_"))
    request = messages.make(f"{camel}Request") if fields else None
    for field, value in fields.items():
        target = request
        *path, last = field.split("__")
        for part in path:
            target = getattr(target, part)
        assert hasattr(target, last)
        object.__setattr__(target, last, value)
    response = getattr(services, name)(request, messages.make(response))
    return response.result.result, response


def state(services, messages):
    result, response = call(
        services, messages, "get_simulation_state", "GetSimulationStateResponse"
    )
    assert result == 1
    return response.state.state


def test_states_and_steps(services, messages):
    def go(wanted):
        return call(services, messages, "set_simulation_state", state__state=wanted)[0]

    def step(count):
        return call(services, messages, "step_simulation", steps=count)[0]

    assert state(services, messages) == STOPPED
    assert step(7) == 1 and state(services, messages) == PAUSED
    stamp_ns, sample, _ = services._ask("sample")[1]
    assert (stamp_ns, sample.steps) == (7_000_000, 7)
    assert go(PLAYING) == 1 and state(services, messages) == PLAYING
    assert go(PLAYING) == 101  # already there
    assert step(1) == 3  # incorrect state: it runs
    assert go(PAUSED) == 1 and state(services, messages) == PAUSED
    assert go(STOPPED) == 1 and state(services, messages) == STOPPED
    assert services._ask("sample")[1][1].steps == 0
    assert go(77) == 0  # not supported
    assert not services._signals.received
    assert go(QUITTING) == 1 and services._signals.received


def test_reset_restores_the_state_but_not_the_time(services, messages):
    call(services, messages, "step_simulation", steps=5)
    assert call(services, messages, "reset_simulation", scope=1)[0] == 0
    for scope in (0, 2, 255):
        before = services._ask("sample")[1][0]
        assert call(services, messages, "reset_simulation", scope=scope)[0] == 1
        stamp_ns, sample, _ = services._ask("sample")[1]
        assert stamp_ns > before and sample.steps == 0


def test_entities_are_bodies_in_world_axes(services, messages):
    def entities(**filters):
        result, response = call(
            services,
            messages,
            "get_entities_states",
            "GetEntitiesStatesResponse",
            **{f"filters__{name}": value for name, value in filters.items()},
        )
        return result, response.entities, response.states

    assert entities(filter="")[1] == ["arm", "leg"]
    assert entities(filter="a.*")[1] == ["arm"]
    assert entities(filter="a")[1] == []
    assert entities(filter="(")[0] == 4
    assert entities(categories=[messages.make("EntityCategory")])[0] == 0
    _, _, (arm, leg) = entities(filter="")
    assert arm.header.frame_id == leg.header.frame_id == "map"
    assert [arm.pose.position.x, arm.pose.position.y, arm.pose.position.z] == [1.0, 2.0, 3.0]
    # A quarter turn about z: body x is world y, body y is world -x.
    half = np.sqrt(0.5)
    assert [arm.pose.orientation.z, arm.pose.orientation.w] == pytest.approx([half, half])
    assert [arm.twist.linear.x, arm.twist.linear.y, arm.twist.linear.z] == pytest.approx(
        [0.0, 1.0, 0.0], abs=1e-15
    )
    assert [arm.twist.angular.x, arm.twist.angular.y, arm.twist.angular.z] == pytest.approx(
        [-2.0, 0.0, 0.0], abs=1e-15
    )
