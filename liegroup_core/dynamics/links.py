# SPDX-License-Identifier: Apache-2.0
"""Operations of the sweeps on a link or a cut joint, in space or in a plane by the type of the model."""

from . import plane, space
from .algebra import by_space as _by_space


def _asked(*names):
    return (_by_space(name, space, plane) for name in names)


momentum, bias_force, body_wrench = _asked("momentum", "bias_force", "body_wrench")
move_link, apply, without_freedoms = _asked("move_link", "apply", "without_freedoms")
start, pass_inertia, accelerated = _asked("start", "pass_inertia", "accelerated")
acceleration_of, leave = _asked("acceleration_of", "leave")
seen_from, set_variable_row = _asked("seen_from", "set_variable_row")
store_parent_row, row_bracket = _asked("store_parent_row", "row_bracket")
set_place, lift_links = _asked("set_place", "lift_links")
