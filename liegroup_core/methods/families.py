# SPDX-License-Identifier: Apache-2.0
"""Integrator class of each method family: it implements all methods of METHODS of that family.

`family(method, layout, group, step, options)` creates an integrator. It has
    options(method)  static; {name: (default, description of valid values, check)} of its options
    work             scratch memory; work.report[LARGEST_TURN] is the largest squared rotation of a stage
    restart()        clear the memory between calls, because a state was set
    memory           arrays of the memory between calls; writing to them restores it
    advance(h, steps, pose, twist, external) -> (steps done, status), in place; external: see
                     forces/external.py; on failure pose and twist are the last valid ones
    substeps         (accepted, attempted) since the restart; (0, 0) without error control
and with error control
    tighten(part)    multiply the tolerances of the options by `part`
"""

from liegroup_core.fields.arguments import got
from liegroup_core.methods.generalized_alpha.generalized_alpha import GeneralizedAlpha
from liegroup_core.methods.munthe_kaas.munthe_kaas import MuntheKaas
from liegroup_core.methods.rattle.rattle import Constrained
from liegroup_core.methods.rotation.bodies import misfit as rotation_misfit
from liegroup_core.methods.rotation.rotation import Rotation

from .table import CONFIGURATION_GROUPS, METHODS, RELATIVE

FAMILIES = {"rkmk": MuntheKaas, "generalized_alpha": GeneralizedAlpha, "rotation": Rotation, "constrained": Constrained}
NOT_ON_SE3 = ("rotation", "constrained")  # families without SE(3)^n
ON_JOINTS = ("rkmk", "generalized_alpha", "constrained")  # families with relative coordinates


def check_options(method, options):
    """Complete the options of a method with its defaults. Raises ValueError, one line."""
    known = FAMILIES[METHODS[method].family].options(METHODS[method])
    for name, value in options.items():
        if name not in known:
            has = f"it has: {', '.join(known)}" if known else "it has none"
            raise ValueError(f"method {method} has no option {name!r}; {has}")
        _, text, is_good = known[name]
        if not is_good(value):
            raise ValueError(f"{name} must be {text}, {got(value)}")
    return {name: options.get(name, default) for name, (default, _, _) in known.items()}


def check_group(method, group):
    """Raise ValueError, one line, for a group that is unknown or that a method does not support."""
    if group not in ("auto", *CONFIGURATION_GROUPS):
        raise ValueError(f"unknown group {group!r}; choose one of: auto, {', '.join(CONFIGURATION_GROUPS)}")
    family = METHODS[method].family
    if group == RELATIVE and family not in ON_JOINTS:
        raise ValueError(
            f"method {method} does not support group 'relative': choose a Munthe-Kaas method, "
            "rkmk..., generalized_alpha, constrained_rattle, or another group"
        )
    if family in NOT_ON_SE3 and group == "se3":
        others = "'so3xr3', 'relative' or 'auto'" if family in ON_JOINTS else "'so3xr3' or 'auto'"
        raise ValueError(f"method {method} does not integrate on SE(3): group must be {others}, got {group!r}")


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
    """Create the integrator of a method; options: checked by `check_options`.

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
