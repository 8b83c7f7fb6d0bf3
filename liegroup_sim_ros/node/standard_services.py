# SPDX-License-Identifier: Apache-2.0
"""Services and the action of the package simulation_interfaces, if it is installed.

They have Gazebo's names: that of their type in lower case. Older versions of the package lack some
types; their services are then not offered. Paused at step 0 is "stopped".
"""

import importlib.util

from liegroup_sim_ros.numbers import counted
from liegroup_sim_ros.version import __version__

from . import standard_codes as codes
from .standard_codes import answered
from .standard_entities import Entities
from .standard_worlds import Worlds

# {service: type, features that it supports}
SERVICES = {
    "get_simulator_features": ("GetSimulatorFeatures", ()),
    "reset_simulation": ("ResetSimulation", (codes.SIMULATION_RESET, codes.SIMULATION_RESET_STATE)),
    "step_simulation": (
        "StepSimulation",
        (codes.STEP_SIMULATION_SINGLE, codes.STEP_SIMULATION_MULTIPLE),
    ),
    "get_simulation_state": ("GetSimulationState", (codes.SIMULATION_STATE_GETTING,)),
    "set_simulation_state": (
        "SetSimulationState",
        (codes.SIMULATION_STATE_SETTING, codes.SIMULATION_STATE_PAUSE),
    ),
    "get_entities": ("GetEntities", ()),
    "get_entities_states": ("GetEntitiesStates", ()),
    "get_entity_state": ("GetEntityState", (codes.ENTITY_STATE_GETTING,)),
    "set_entity_state": ("SetEntityState", (codes.ENTITY_STATE_SETTING,)),
    "load_world": ("LoadWorld", (codes.WORLD_LOADING, codes.WORLD_RESOURCE_STRING)),
    "get_current_world": ("GetCurrentWorld", (codes.WORLD_INFO_GETTING,)),
    "get_available_worlds": ("GetAvailableWorlds", (codes.AVAILABLE_WORLDS,)),
}
ACTION = "simulate_steps"
MOST_STEPS = 1_000_000  # a call, as step_count
FEEDBACK = 1000  # messages that wait for a slow subscriber; there is one for each step


def is_installed():
    """Whether the package simulation_interfaces can be imported."""
    return importlib.util.find_spec("simulation_interfaces") is not None


def offer(node, signals, world_frame):
    """Create the services and the action of a SimNode. Does nothing without the package."""
    if not is_installed():
        return
    from simulation_interfaces import action, msg, srv

    features = {codes.STEP_SIMULATION_ACTION} if hasattr(action, "SimulateSteps") else set()
    offered = {
        name: (getattr(srv, kind), supported)
        for name, (kind, supported) in SERVICES.items()
        if hasattr(srv, kind)
    }
    features.update(*(supported for _, supported in offered.values()))
    handlers = (
        Control(node.ask, signals, sorted(features)),
        Entities(node.ask, world_frame, msg.EntityState),
        Worlds(node, getattr(msg, "WorldResource", None)),
    )
    for name, (kind, _) in offered.items():
        callback = next(getattr(h, name) for h in handlers if hasattr(h, name))
        node.create_service(kind, f"~/{name}", callback)
    if codes.STEP_SIMULATION_ACTION in features:
        _offer_action(node, action.SimulateSteps)


def _offer_action(node, kind):
    from rclpy.action import ActionServer, CancelResponse
    from rclpy.qos import QoSProfile

    steps = SimulateSteps(node.ask, kind)
    node.simulate_steps = ActionServer(
        node,
        kind,
        f"~/{ACTION}",
        steps.execute,
        cancel_callback=lambda _: CancelResponse.ACCEPT,
        feedback_pub_qos_profile=QoSProfile(depth=FEEDBACK),
    )


class Control:
    """Callbacks that control the run.

    ask      : function (command, *arguments) -> (True, result) or (False, text): SimNode.ask
    signals  : Signals; setting `received` ends the node
    features : numbers of SimulatorFeatures
    """

    def __init__(self, ask, signals, features):
        self._ask, self._signals, self._features = ask, signals, features

    def get_simulator_features(self, _, response):
        """Return the features that are supported."""
        response.features.features = self._features
        response.features.custom_info = (
            f"liegroup_sim_ros {__version__}. Worlds are scenes (YAML) and robots (URDF, xacro, "
            "SDF, MJCF), entities are their bodies."
        )
        return response

    def reset_simulation(self, request, response):
        """Reset to the initial state; simulated time continues, so time alone cannot be reset."""
        scope = request.scope
        if scope not in (0, codes.SCOPE_ALL) and (
            scope & codes.SCOPE_TIME or not scope & codes.SCOPE_STATE
        ):
            return answered(
                response,
                codes.NOT_SUPPORTED,
                f"scope {scope}: only the state can be reset (scope 0, 2 or 255); simulated time "
                "increases monotonically",
            )
        done, text = self._ask("reset")
        return answered(response, codes.OK if done else codes.FAILED, text)

    def step_simulation(self, request, response):
        """Take the requested number of steps while paused."""
        if request.steps > MOST_STEPS:
            return answered(
                response,
                codes.FAILED,
                f"{request.steps} steps are too many for one call: take at most {MOST_STEPS}, or "
                f"use the action ~/{ACTION}",
            )
        done, text = self._ask("step", request.steps)
        return answered(response, codes.OK if done else codes.FAILED, text)

    def get_simulation_state(self, _, response):
        """Return stopped, playing or paused."""
        response.state.state, text = self._state()
        return answered(response, codes.OK, text)

    def set_simulation_state(self, request, response):
        """Stop (pause and reset), play, pause or quit."""
        requested, (current, _) = request.state.state, self._state()
        if requested == current:
            return answered(response, codes.ALREADY_THERE)
        if (current, requested) == (codes.STOPPED, codes.PAUSED):
            return answered(
                response,
                codes.INCORRECT_TRANSITION,
                "the simulation is stopped: it is paused at step 0",
            )
        if requested == codes.QUITTING:
            self._signals.received = True
            return answered(response, codes.OK, "the node is shutting down")
        commands = {
            codes.STOPPED: ("hold", "reset"),
            codes.PLAYING: ("resume",),
            codes.PAUSED: ("pause",),
        }.get(requested)
        if commands is None:
            return answered(
                response,
                codes.NOT_SUPPORTED,
                f"state {requested} cannot be set: choose stopped (0), playing (1), paused (2) or "
                "quitting (3)",
            )
        for command in commands:
            done, text = self._ask(command)
            if not done:
                return answered(response, codes.TRANSITION_ERROR, text)
        return answered(response, codes.OK, text)

    def _state(self):
        """(SimulationState, text)."""
        done, result = self._ask("sample")
        if not done:
            return codes.QUITTING, result
        if result.state == "running":
            return codes.PLAYING, ""
        text = (
            "the simulation has stopped with an error: reset it"
            if result.state == "faulted"
            else ""
        )
        return (codes.PAUSED if result.sample.steps else codes.STOPPED), text


class SimulateSteps:
    """The action: steps while paused, with feedback after each one.

    ask  : as of Control
    kind : class of the action
    """

    def __init__(self, ask, kind):
        self._ask, self._kind = ask, kind

    async def execute(self, goal):
        """Take the steps of a goal handle; other callbacks run between two steps."""
        count, done, text = goal.request.steps, 0, ""
        feedback = self._kind.Feedback()
        while done < count and not goal.is_cancel_requested:
            reached, text = self._ask("advance", 1)
            if not reached or not text:  # refused, or stopped by an error
                break
            done += 1
            feedback.completed_steps, feedback.remaining_steps = done, count - done
            goal.publish_feedback(feedback)
            await _Turn()
        if done:
            self._ask("stepped", done)
        result, steps = self._kind.Result(), counted(count, "step")
        if done == count:
            goal.succeed()
            return answered(result, codes.OK, steps)
        if goal.is_cancel_requested:
            goal.canceled()
            return answered(result, codes.FAILED, f"cancelled after {done} of {steps}")
        goal.abort()
        reason = text or "the simulation has stopped with an error: see ~/events"
        return answered(result, codes.FAILED, f"stopped after {done} of {steps}: {reason}")


class _Turn:
    """Awaitable that lets the executor run other callbacks once."""

    def __await__(self):
        yield
