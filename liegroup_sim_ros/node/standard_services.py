# SPDX-License-Identifier: Apache-2.0
"""Services of the package simulation_interfaces, if it is installed, under Gazebo's names.

    ~/reset_simulation  ~/step_simulation  ~/set_simulation_state  ~/get_simulation_state
    ~/get_entities_states

Codes are given as numbers: the names of the constants differ between versions of the package, the
numbers do not. Paused at step 0 is "stopped".
"""

import re

OK, NOT_SUPPORTED, INCORRECT_STATE, FAILED = 1, 0, 3, 4  # Result
STOPPED, PLAYING, PAUSED, QUITTING = 0, 1, 2, 3  # SimulationState
ALREADY_THERE, TRANSITION_ERROR = 101, 102  # SetSimulationState
SCOPE_DEFAULT, SCOPE_STATE, SCOPE_ALL = 0, 2, 255  # ResetSimulation


def offer(node, signals, world_frame):
    """Create the services of a SimNode. Does nothing if simulation_interfaces is not installed."""
    try:
        from simulation_interfaces import msg, srv
    except ImportError:
        return
    services = StandardServices(node.ask, signals, world_frame, msg.EntityState)
    for name, kind in (
        ("reset_simulation", srv.ResetSimulation),
        ("step_simulation", srv.StepSimulation),
        ("set_simulation_state", srv.SetSimulationState),
        ("get_simulation_state", srv.GetSimulationState),
        ("get_entities_states", srv.GetEntitiesStates),
    ):
        node.create_service(kind, f"~/{name}", getattr(services, name))


class StandardServices:
    """Callbacks that translate services of simulation_interfaces to commands of the simulation.

    ask          : function (command, *arguments) -> (True, result) or (False, text): SimNode.ask
    signals      : Signals; setting `received` ends the node
    world_frame  : frame id of poses and twists
    entity_state : class of the message EntityState
    """

    def __init__(self, ask, signals, world_frame, entity_state):
        self._ask, self._signals = ask, signals
        self._world_frame, self._entity_state = world_frame, entity_state

    def reset_simulation(self, request, response):
        """Reset to the initial state; simulated time continues, so time alone cannot be reset."""
        if request.scope not in (SCOPE_DEFAULT, SCOPE_STATE, SCOPE_ALL):
            return _answer(
                response,
                NOT_SUPPORTED,
                "only the state can be reset (scope 0, 2 or 255); simulated time increases "
                "monotonically",
            )
        return _answer(response, *_result(self._ask("reset"), FAILED))

    def step_simulation(self, request, response):
        """Take the requested number of steps while paused."""
        return _answer(response, *_result(self._ask("step", request.steps), INCORRECT_STATE))

    def get_simulation_state(self, request, response):
        """Return stopped, playing or paused."""
        response.state.state, text = self._state()
        return _answer(response, OK, text)

    def set_simulation_state(self, request, response):
        """Stop (pause and reset), play, pause or quit."""
        requested, (current, _) = request.state.state, self._state()
        if requested == current:
            return _answer(response, ALREADY_THERE, "")
        if requested == QUITTING:
            self._signals.received = True
            return _answer(response, OK, "the node is shutting down")
        commands = {STOPPED: ("hold", "reset"), PLAYING: ("resume",), PAUSED: ("pause",)}.get(
            requested
        )
        if commands is None:
            return _answer(response, NOT_SUPPORTED, f"unknown state {requested}")
        for command in commands:
            done, text = self._ask(command)
            if not done:
                return _answer(response, TRANSITION_ERROR, text)
        return _answer(response, OK, text)

    def get_entities_states(self, request, response):
        """Poses and twists of the bodies whose whole names match the filter, in world axes."""
        filters = request.filters
        bounded = getattr(getattr(filters, "bounds", None), "points", ())
        if len(filters.categories) or len(filters.tags.tags) or len(bounded):
            return _answer(response, NOT_SUPPORTED, "bodies have names only: filter by name")
        try:
            matches = re.compile(filters.filter or ".*").fullmatch
        except re.error as error:
            return _answer(response, FAILED, f"filter {filters.filter!r}: {error}")
        done, result = self._ask("sample")
        if not done:
            return _answer(response, FAILED, result)
        stamp_ns, sample, _ = result
        response.entities = [body for body in sample.body_names if matches(body)]
        response.states = [self._entity(stamp_ns, sample, body) for body in response.entities]
        return _answer(response, OK, "")

    def _state(self):
        """(SimulationState, text)."""
        done, result = self._ask("sample")
        if not done:
            return QUITTING, result
        _, sample, state = result
        if state == "running":
            return PLAYING, ""
        text = "the simulation has stopped with an error: reset it" if state == "faulted" else ""
        return (PAUSED if sample.steps else STOPPED), text

    def _entity(self, stamp_ns, sample, body):
        state = self._entity_state()
        state.header.frame_id = self._world_frame
        state.header.stamp.sec, state.header.stamp.nanosec = divmod(stamp_ns, 10**9)
        rotation, twist = sample.poses[body][:3, :3], sample.twists[body]
        for target, names, values in (
            (state.pose.position, "xyz", sample.positions[body]),
            (state.pose.orientation, "xyzw", sample.quaternions[body]),
            (state.twist.angular, "xyz", rotation @ twist[:3]),
            (state.twist.linear, "xyz", rotation @ twist[3:]),
        ):
            for name, value in zip(names, values):
                setattr(target, name, float(value))
        return state


def _result(answer, failure_code):
    done, text = answer
    return (OK if done else failure_code), text


def _answer(response, code, text):
    response.result.result, response.result.error_message = code, text
    return response
