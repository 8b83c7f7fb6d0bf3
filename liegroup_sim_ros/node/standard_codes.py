# SPDX-License-Identifier: Apache-2.0
"""Numbers of simulation_interfaces; the names of the constants differ between its versions."""

import functools

# Result, for all services
NOT_SUPPORTED, OK, NOT_FOUND, INCORRECT_STATE, FAILED = range(5)
# Results of single services
ALREADY_THERE, TRANSITION_ERROR, INCORRECT_TRANSITION = 101, 102, 103  # SetSimulationState
INVALID_POSE = 101  # SetEntityState
UNSUPPORTED_FORMAT, NO_RESOURCE, PARSE_ERROR = 101, 102, 103  # LoadWorld
MISSING_ASSETS, UNSUPPORTED_ELEMENTS = 104, 106

STOPPED, PLAYING, PAUSED, QUITTING = range(4)  # SimulationState
SCOPE_TIME, SCOPE_STATE, SCOPE_ALL = 1, 2, 255  # ResetSimulation, bits

# SimulatorFeatures
ENTITY_STATE_GETTING, ENTITY_STATE_SETTING = 10, 11
SIMULATION_RESET, SIMULATION_RESET_STATE = 20, 22
SIMULATION_STATE_GETTING, SIMULATION_STATE_SETTING, SIMULATION_STATE_PAUSE = 24, 25, 26
STEP_SIMULATION_SINGLE, STEP_SIMULATION_MULTIPLE, STEP_SIMULATION_ACTION = 31, 32, 33
WORLD_LOADING, WORLD_RESOURCE_STRING, WORLD_INFO_GETTING, AVAILABLE_WORLDS = 40, 41, 44, 45


class Refused(Exception):
    """A request that is refused: number of the result, and one line of text."""


def answered(response, code, text=""):
    """The response of a service, or the result of an action, with its result."""
    response.result.result, response.result.error_message = code, text
    return response


def answering(callback):
    """Method (request, response) -> text as the callback of a service; Refused becomes its result."""

    @functools.wraps(callback)
    def serve(self, request, response):
        try:
            return answered(response, OK, callback(self, request, response) or "")
        except Refused as refusal:
            return answered(response, *refusal.args)

    return serve
