# SPDX-License-Identifier: Apache-2.0
"""Services and the action of the package simulation_interfaces, if it is installed.

As in Gazebo, the name of a service is its type in lower case with underscores. Older versions of the
package lack some types; services of these types are not offered. "Stopped" means paused at step 0.
"""

import importlib.util

from liegroup_sim_ros.numbers import counted
from liegroup_sim_ros.serving.simulation_commands import CommandError
from liegroup_sim_ros.version import __version__

from . import standard_codes as codes
from .answers import Turn, filled, in_executor
from .standard_codes import Refused
from .standard_entities import Entities
from .standard_worlds import Worlds

# {service: type, features that it supports}
SERVICES = {
    "get_simulator_features": ("GetSimulatorFeatures", ()),
    "reset_simulation": ("ResetSimulation", (codes.SIMULATION_RESET, codes.SIMULATION_RESET_STATE)),
    "step_simulation": ("StepSimulation", (codes.STEP_SIMULATION_SINGLE, codes.STEP_SIMULATION_MULTIPLE)),
    "get_simulation_state": ("GetSimulationState", (codes.SIMULATION_STATE_GETTING,)),
    "set_simulation_state": ("SetSimulationState", (codes.SIMULATION_STATE_SETTING, codes.SIMULATION_STATE_PAUSE)),
    "get_entities": ("GetEntities", ()),
    "get_entities_states": ("GetEntitiesStates", ()),
    "get_entity_state": ("GetEntityState", (codes.ENTITY_STATE_GETTING,)),
    "set_entity_state": ("SetEntityState", (codes.ENTITY_STATE_SETTING,)),
    "load_world": ("LoadWorld", (codes.WORLD_LOADING, codes.WORLD_RESOURCE_STRING)),
    "get_current_world": ("GetCurrentWorld", (codes.WORLD_INFO_GETTING,)),
    "get_available_worlds": ("GetAvailableWorlds", (codes.AVAILABLE_WORLDS,)),
}
ACTION = "simulate_steps"
MOST_STEPS = 1_000_000  # per call, as for step_count
PART = 0.01  # s of wall time for steps before other commands are executed
FEEDBACK = 1000  # messages queued for a slow subscriber; each step sends one


def is_installed():
    """Whether the package simulation_interfaces can be imported."""
    return importlib.util.find_spec("simulation_interfaces") is not None


def offer(node, world_frame):
    """Create the services and the action of a SimNode. Does nothing without the package."""
    if not is_installed():
        return
    from simulation_interfaces import action, msg, srv

    features = {codes.STEP_SIMULATION_ACTION} if hasattr(action, "SimulateSteps") else set()
    offered = {
        name: (getattr(srv, kind), supported) for name, (kind, supported) in SERVICES.items() if hasattr(srv, kind)
    }
    features.update(*(supported for _, supported in offered.values()))
    handlers = (
        Control(node.ask, node.signals, sorted(features)),
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

    ask      : coroutine function (command, *arguments) -> result: AnsweringNode.ask
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

    async def reset_simulation(self, request, _):
        """Reset to the initial state; simulated time continues, so time alone cannot be reset."""
        scope = request.scope
        if scope not in (0, codes.SCOPE_ALL) and (scope & codes.SCOPE_TIME or not scope & codes.SCOPE_STATE):
            raise Refused(
                codes.NOT_SUPPORTED,
                f"scope {scope}: only the state can be reset (scope 0, 2 or 255); simulated time "
                "increases monotonically",
            )
        return await self._ask("reset")

    async def step_simulation(self, request, _):
        """Take the requested number of steps while paused."""
        if request.steps > MOST_STEPS:
            raise Refused(
                codes.FAILED,
                f"{request.steps} steps are too many for one call: take at most {MOST_STEPS}, or "
                f"use the action ~/{ACTION}",
            )
        return await take_steps(self._ask, request.steps)

    async def get_simulation_state(self, _, response):
        """Return stopped, playing or paused."""
        response.state.state, text = await self._state()
        return filled(response, codes.OK, text)

    async def set_simulation_state(self, request, _):
        """Stop (pause and reset), play, pause or quit."""
        requested, (current, _) = request.state.state, await self._state()
        if requested == current:
            raise Refused(codes.ALREADY_THERE, "")
        if (current, requested) == (codes.STOPPED, codes.PAUSED):
            raise Refused(codes.INCORRECT_TRANSITION, "the simulation is already paused at step 0 (stopped)")
        if requested == codes.QUITTING:
            self._signals.received = True
            return "the node is shutting down"
        commands = {codes.STOPPED: ("hold", "reset"), codes.PLAYING: ("resume",), codes.PAUSED: ("pause",)}.get(
            requested
        )
        if commands is None:
            raise Refused(
                codes.NOT_SUPPORTED,
                f"state {requested} cannot be set: choose stopped (0), playing (1), paused (2) or quitting (3)",
            )
        try:
            for command in commands:
                text = await self._ask(command)
        except CommandError as error:
            raise Refused(codes.TRANSITION_ERROR, str(error)) from None
        return text

    async def _state(self):
        """(SimulationState, text)."""
        try:
            moment = await self._ask("sample")
        except Refused as refusal:
            return codes.QUITTING, refusal.args[1]
        if moment.state == "running":
            return codes.PLAYING, ""
        text = "the simulation has stopped with an error: reset it" if moment.state == "faulted" else ""
        return (codes.PAUSED if moment.sample.steps else codes.STOPPED), text


async def take_steps(ask, count):
    """Take steps while paused; other commands are executed in between. Returns one line of text.

    Raises CommandError if they end early.
    """
    done, reached, reason = 0, True, ""
    while done < count and reached:
        try:
            taken, reached = await ask("advance", count - done, PART)
        except CommandError as error:  # such as after ~/resume
            if not done:
                raise
            reached, reason = False, f": {error}"
        else:
            done += taken
            await Turn()
    text = await ask("stepped", done)
    if done < count:
        raise CommandError(f"stopped after {done} of {counted(count, 'step')}{reason}")
    return text


class SimulateSteps:
    """Action that takes steps while paused, with feedback after each one.

    ask  : as in Control
    kind : class of the action
    """

    def __init__(self, ask, kind):
        self._ask, self._kind = ask, kind

    async def execute(self, goal):
        """Take the steps of a goal handle; other callbacks run between two steps."""
        return await in_executor(self._steps(goal))

    async def _steps(self, goal):
        count, done, reason = goal.request.steps, 0, ""
        feedback = self._kind.Feedback()
        try:
            while done < count and not goal.is_cancel_requested:
                taken, reached = await self._ask("advance", 1, PART)  # in lockstep it may wait for answers
                if not reached:
                    reason = "the simulation has stopped with an error: see ~/events"
                    break
                if not taken:
                    await Turn()
                    continue
                done += 1
                feedback.completed_steps, feedback.remaining_steps = done, count - done
                goal.publish_feedback(feedback)
                await Turn()
            if done:
                await self._ask("stepped", done)
        except (CommandError, Refused) as error:
            reason = error.args[-1]
        result, steps = self._kind.Result(), counted(count, "step")
        if done == count and not reason:
            goal.succeed()
            return filled(result, codes.OK, steps)
        if goal.is_cancel_requested:
            goal.canceled()
            return filled(result, codes.FAILED, f"cancelled after {done} of {steps}")
        goal.abort()
        return filled(result, codes.FAILED, f"stopped after {done} of {steps}: {reason}")
