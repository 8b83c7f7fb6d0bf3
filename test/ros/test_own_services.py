# SPDX-License-Identifier: Apache-2.0
"""~/set_state and ~/apply_wrench of a running node, over DDS, and in its recording."""

from importlib.util import find_spec

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, TwistStamped
from node_process import NodeProcess, stamp_ns
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from scene_files import cases, text_of
from sensor_msgs.msg import JointState

from liegroup_sim_ros.commands.main import main

NODE = "/own"
SCENE = text_of("rig_own_services.yaml")


class Own:
    def __init__(self, client, folder):
        self._client = client
        self.pose = client.listen(f"{NODE}/stone/pose", PoseStamped)
        self.twist = client.listen(f"{NODE}/stone/twist", TwistStamped)
        self.joints = client.listen(f"{NODE}/joint_states", JointState)
        self.record = folder / "run.mcap"

    def call(self, service, values):
        request = SetParametersAtomically.Request(
            parameters=[Parameter(n, value=v).to_parameter_msg() for n, v in values]
        )
        result = self._client.call(f"{NODE}/{service}", SetParametersAtomically, request).result
        assert "\n" not in result.reason
        return result.successful, result.reason

    def step(self, count):
        """(pose, twist) numbers of the stone after some steps."""
        assert self._client.set(NODE, step_count=count).successful
        message = self._client.call(f"{NODE}/step").message
        now = round(float(message.rpartition(" at ")[2].split()[0]) * 1e9)
        both = (self.pose, self.twist)
        self._client.until(lambda: all(k and stamp_ns(k[-1].header.stamp) == now for k in both))
        p, t = self.pose[-1].pose, self.twist[-1].twist
        return (
            [p.position.x, p.position.y, p.position.z, *(getattr(p.orientation, c) for c in "xyzw")],
            [*(getattr(part, c) for part in (t.angular, t.linear) for c in "xyz")],
        )


@pytest.fixture(scope="module")
def own(client, tmp_path_factory):
    folder = tmp_path_factory.mktemp("own")
    (folder / "rig.yaml").write_text(SCENE)
    parameters = {
        "scene": folder / "rig.yaml",
        "method": "rkmk4",
        "start_paused": True,
        "joint_state_rate": 1000.0,
        "record": folder / "run.mcap",
    }
    with NodeProcess(parameters, [f"__node:={NODE[1:]}"]) as process:
        own = Own(client, folder)
        client.call(f"{NODE}/pause")
        yield own
        process.end()
        assert main(["replay", str(own.record), "--resimulate"]) == 0


@pytest.mark.skipif(find_spec("simulation_interfaces") is not None, reason="simulation_interfaces is installed here")
def test_without_simulation_interfaces_the_node_has_its_own_services_only(client, own):
    names = {name for name, _ in client.node.get_service_names_and_types()}
    assert f"{NODE}/reset" in names and f"{NODE}/get_simulator_features" not in names


def test_a_state_is_set_and_joints_stay_closed(own):
    pose = [1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8]
    done, text = own.call(
        "set_state",
        [("stone/pose", pose), ("stone/twist", [0.0, 0.0, 0.0, 0.0, 0.0, 4.0]), ("arm/pose", [0, 0, 0, 0, 0, 0, 1])],
    )
    assert done and text.startswith("stone/pose and stone/twist and arm/pose at ")
    found, twist = own.step(1)
    assert found == pytest.approx([1.0, 2.0, 3.004, *pose[3:]], abs=1e-12)
    assert twist == pytest.approx([0, 0, 0, 0, 0, 4.0], abs=1e-12)


def test_joints_are_set_by_name(own):
    """Those that are not named keep position and velocity; both are those of the next step."""
    for values, expected in (
        ([("axle/position", 0.5), ("axle/velocity", 2.0)], [0.502, 0.0, 2.0, 0.0]),
        ([("rail/position", 3), ("rail/velocity", 0.0), ("axle/velocity", 0)], [0.502, 3.0, 0, 0]),
        ([("rail/velocity", -1.0)], [0.502, 2.999, 0.0, -1.0]),
    ):
        done, text = own.call("set_state", values)
        assert done and text.startswith(" and ".join(name for name, _ in values))
        own.step(1)
        message = own.joints[-1]
        assert message.name == ["axle", "rail"]
        assert [*message.position, *message.velocity] == pytest.approx(expected, abs=1e-5)


def test_a_force_at_a_point_has_its_torque_for_its_duration(own):
    """No rotation at the start: w_z = r x f / I_z t, until it ends inside a step."""
    assert own.call("set_state", [("stone/pose", [0.0] * 6 + [1.0]), ("stone/twist", [0.0] * 6)])[0]
    done, text = own.call(
        "apply_wrench",
        [
            ("body", "stone"),
            ("force", [0.0, 6.0, 0.0]),
            ("point", [2.0, 0.0, 0.0]),
            ("torque", [0.0, 0.0, -4.0]),
            ("duration", 0.0105),
        ],
    )
    assert done and text.startswith("wrench on stone for 0.0105 s")
    _, twist = own.step(10)
    assert twist[2] == pytest.approx(8.0 / 4.0 * 0.010, rel=1e-9)
    _, twist = own.step(30)
    assert twist[2] == pytest.approx(8.0 / 4.0 * 0.0105, rel=1e-9)
    assert np.hypot(twist[3], twist[4]) == pytest.approx(3.0 * 0.0105, rel=1e-6)


def test_a_pull_swings_its_body_about_a_point_in_the_world(own):
    """Without damping: v = omega a sin(omega t), and it ends by its duration."""
    assert own.call("set_state", [("stone/pose", [0.0] * 6 + [1.0]), ("stone/twist", [0.0] * 6)])[0]
    mass, to, omega = 2.0, 0.3, 20.0
    values = [("body", "stone"), ("to", [to, 0.0, 0.0]), ("stiffness", mass * omega**2), ("duration", 0.0105)]
    done, text = own.call("apply_pull", values)
    assert done and text.startswith("pull on stone for 0.0105 s")
    _, twist = own.step(10)
    assert twist[3] == pytest.approx(omega * to * np.sin(omega * 0.010), rel=1e-6)
    _, twist = own.step(30)
    assert twist[3] == pytest.approx(omega * to * np.sin(omega * 0.0105), rel=1e-6)


def test_a_force_in_world_axes_at_a_point_turns_the_body_towards_it(own):
    """A pendulum whose stone is held by nothing: torque p x R^T F about z, at a turned attitude.

    The stone turns by 2 rad/s: 0.02 rad within the 10 ms, so its lever changes by 2 %. The torque is
    -x f sin(angle): d omega / dt = -x f / I_z sin(angle), integrated here by the trapezoidal rule.
    """
    angle, spin = 0.5, 2.0
    pose = [0.0] * 5 + [np.sin(angle / 2), np.cos(angle / 2)]
    assert own.call("set_state", [("stone/pose", pose), ("stone/twist", [0.0, 0.0, spin, 0.0, 0.0, 0.0])])[0]
    done, _ = own.call(
        "apply_wrench",
        [
            ("body", "stone"),
            ("force", [600.0, 0.0, 0.0]),
            ("point", [2.0, 0.0, 0.0]),
            ("axes", "world"),
            ("duration", 0.010),
        ],
    )
    assert done
    h = 1e-6
    for _ in range(10_000):
        spin -= h * 2.0 * 600.0 / 4.0 * np.sin(angle + 0.5 * h * spin)
        angle += h * spin
    _, twist = own.step(20)
    assert twist[2] == pytest.approx(spin, abs=1e-5)


@pytest.mark.parametrize("service, values, text", cases("wrong_values_are_refused_and_nothing_changes"))
def test_wrong_values_are_refused_and_nothing_changes(own, service, values, text):
    assert own.call("set_state", [("stone/twist", [0.0] * 6)])[0]
    before = own.step(1)  # at rest
    done, reason = own.call(service, values)
    assert not done and text in reason
    assert own.step(2) == before
