# SPDX-License-Identifier: Apache-2.0
"""Inputs that wait for the simulation thread: what is replaced is counted, what is too late refused."""

import math

import pytest
from scene_files import text_of

from liegroup_core import Simulation
from liegroup_core.forces.commands import EFFORT, MOVE, Command
from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.messages.commands import Point
from liegroup_sim_ros.serving.inbox import Inbox
from liegroup_sim_ros.serving.trajectory import Waypoints

SCENE = text_of("rig_inbox.yaml")


@pytest.fixture
def simulation():
    return Simulation(scene_from_text(SCENE), "rkmk8", 1e-3)


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
