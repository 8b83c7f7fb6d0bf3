# SPDX-License-Identifier: Apache-2.0
"""State of bodies, for integrators on them: the caller's arrays, in place. Twin of link_state.py."""

from liegroup_core.compiling import kernel
from liegroup_core.status import OK


@kernel
def enter(model, work, pose, twist, external):
    """Return the caller's arrays: they are integrated in place."""
    return pose, twist, external, OK


@kernel
def leave(model, work, pose, twist, pose_out, twist_out):
    """Do nothing: the caller's arrays were integrated in place."""
    return
