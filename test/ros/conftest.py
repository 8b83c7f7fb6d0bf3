# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the ROS tests, and the import path of their helper modules."""

import importlib.util
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """Scene file with two free bodies, see node_process.SCENE."""
    from node_process import SCENE

    path = tmp_path_factory.mktemp("scene") / "two_bodies.yaml"
    path.write_text(SCENE)
    return path


@pytest.fixture(scope="module")
def client():
    """ROS node in this process, see node_process.Client."""
    from node_process import Client

    client = Client()
    yield client
    client.close()


@pytest.fixture(scope="module")
def ros_node():
    """rclpy node in this process for parts of the simulation node, without its process."""
    import rclpy
    from node_process import own_context

    context = own_context()
    node = rclpy.create_node("sim_node", context=context)
    yield node
    node.destroy_node()
    context.try_shutdown()


@pytest.fixture(scope="module")
def package(request):
    """Environment variables with which a process finds the package; this one finds it already."""
    import simulation_interfaces_types as types
    from interface_package import missing
    from node_process import path_with

    if importlib.util.find_spec("simulation_interfaces"):
        yield {}
        return
    if missing():
        pytest.skip(f"simulation_interfaces is not installed, and to build it {missing()} is missing")
    folder = types.package(types.JAZZY, request.config.cache.mkdir("interfaces"))
    sys.path.insert(0, str(folder))
    yield path_with(folder)
    # Other tests of this process see a machine without the package.
    sys.path.remove(str(folder))
    for name in [name for name in sys.modules if name.partition(".")[0] == "simulation_interfaces"]:
        del sys.modules[name]


@pytest.fixture(scope="module")
def srv(package):
    from simulation_interfaces import srv

    return srv
