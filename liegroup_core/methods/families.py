# SPDX-License-Identifier: Apache-2.0
"""Integrator class of each method family: it implements all methods of METHODS of that family.

`family(method, layout, group, step, options)` creates an integrator. It has
    work             scratch memory; work.report[LARGEST_TURN] is the largest squared rotation of a stage
    restart()        clear the memory between calls, because a state was set
    memory           arrays of the memory between calls; writing to them restores it
    advance(h, steps, pose, twist, external) -> (steps done, status), in place; external: see
                     forces/external.py; on failure pose and twist are the last valid ones
    substeps         (accepted, attempted) since the restart; (0, 0) without error control
and with error control
    tighten(part)    multiply the tolerances of the options by `part`
    lead, inside, look_ahead, forget, choose, stop_at, spent: see MuntheKaas, if it runs ahead of the caller
    switching        Switching, if it has the events of stops and friction
"""

from liegroup_core.methods.generalized_alpha.generalized_alpha import GeneralizedAlpha
from liegroup_core.methods.munthe_kaas.munthe_kaas import MuntheKaas
from liegroup_core.methods.rattle.rattle import Constrained
from liegroup_core.methods.rotation.bodies import misfit as rotation_misfit
from liegroup_core.methods.rotation.rotation import Rotation

from .table import METHODS, RELATIVE

FAMILIES = {"rkmk": MuntheKaas, "generalized_alpha": GeneralizedAlpha, "rotation": Rotation, "constrained": Constrained}
NOT_ON_SE3 = ("rotation", "constrained")  # families without SE(3)^n
ON_JOINTS = ("rkmk", "generalized_alpha", "constrained")  # families with relative coordinates


def choose_group(method, group):
    """Name of the group that a method uses; group: may be "auto"."""
    if group != "auto":
        return group
    return RELATIVE if METHODS[method].family in ON_JOINTS else "so3xr3"


def misfit(method, layout):
    """Reason why a method cannot integrate a scene (layout.Layout) in any group, or ""."""
    family = METHODS[method].family
    if family not in ON_JOINTS and layout.needs_relative:
        return layout.needs_relative
    if family != "rkmk" and (layout.needs_events or layout.rolls):
        return layout.needs_events or layout.rolls
    return rotation_misfit(layout) if family == "rotation" else ""


def fitting_methods(layout):
    """Names of the methods that can integrate a scene (layout.Layout)."""
    return [name for name in METHODS if not misfit(name, layout)]


def make_integrator(method, layout, group, step, options):
    """Create the integrator of a method; options: complete, see settings.check_options.

    Raises ValueError, one line, if the method does not fit the scene or its stabilisation.
    """
    entry = METHODS[method]
    if layout.needs_relative and group != RELATIVE:
        raise ValueError(
            f"method {method} in group {group!r} cannot integrate this scene: "
            f"{layout.needs_relative}. Use group 'relative' with one of: "
            f"{', '.join(fitting_methods(layout))}"
        )
    reason = misfit(method, layout)
    if reason:
        raise ValueError(
            f"method {method} cannot integrate this scene: {reason}. Use one of: {', '.join(fitting_methods(layout))}"
        )
    return FAMILIES[entry.family](entry, layout, group, step, options)
