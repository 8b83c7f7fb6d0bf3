# SPDX-License-Identifier: Apache-2.0
"""Integrators by family: each takes the methods of METHODS that name it.

An integrator is made by `family(method, layout, group, step, options)` and has
    options(method)  {name: (default, what it may be, check)} of what a user can set, static
    kernels          name of the kernels it uses, compiled once on a machine
    work             scratch memory; work.report[0] is the largest squared rotation of a stage
    restart()        forget what lasts between calls, because a state was set
    memory           the arrays that hold what lasts between calls; written to, they restore it
    advance(h, steps, pose, twist, external) -> (steps done, status), in place; external (n, 6) is
                     constant over these steps; pose and twist stay the last good ones
    substeps         (good ones, attempts) since the restart, (0, 0) where there are none
"""

from liegroup_core.integrators.generalized_alpha.generalized_alpha import GeneralizedAlpha
from liegroup_core.integrators.rattle.rattle import Constrained
from liegroup_core.integrators.rkmk.munthe_kaas import MuntheKaas
from liegroup_core.integrators.rotation.bodies import misfit as rotation_misfit
from liegroup_core.integrators.rotation.rotation import Rotation

from .methods import GROUPS, METHODS

FAMILIES = {
    "rkmk": MuntheKaas,
    "generalized_alpha": GeneralizedAlpha,
    "rotation": Rotation,
    "constrained": Constrained,
}
NOT_ON_SE3 = ("rotation", "constrained")  # families with a group of their own


def check_options(method, options):
    """The options of a method completed by its defaults. Raises ValueError, one line."""
    known = FAMILIES[METHODS[method].family].options(METHODS[method])
    for name, value in options.items():
        if name not in known:
            has = f"it has: {', '.join(known)}" if known else "it has none"
            raise ValueError(f"method {method} has no option {name!r}; {has}")
        _, text, is_good = known[name]
        if not is_good(value):
            raise ValueError(f"{name} must be {text}, got {value!r}")
    return {name: options.get(name, default) for name, (default, _, _) in known.items()}


def check_group(method, group):
    """Name of the group that a method moves poses on. Raises ValueError, one line."""
    if group not in ("auto", *GROUPS):
        raise ValueError(f"unknown group {group!r}; choose one of: auto, {', '.join(GROUPS)}")
    alone = METHODS[method].family in NOT_ON_SE3
    if group == "auto":
        return "so3xr3" if alone else "se3"
    if alone and group != "so3xr3":
        raise ValueError(
            f"method {method} integrates on SO(3) x R^3 only: group must be 'so3xr3' or "
            f"'auto', got {group!r}"
        )
    return group


def misfit(method, layout):
    """Why a method cannot serve a scene (layout.Layout), in words, or ""."""
    return rotation_misfit(layout) if METHODS[method].family == "rotation" else ""


def fitting_methods(layout):
    """Names of the methods that can serve a scene."""
    return [name for name in METHODS if not misfit(name, layout)]


def make_integrator(method, layout, group, step, options):
    """The integrator of a method's name, its options checked by `check_options`.

    raises ValueError, one line, where the method does not fit the scene or its stabilisation
    """
    entry = METHODS[method]
    why = misfit(method, layout)
    if why:
        raise ValueError(
            f"method {method} cannot integrate this scene: {why}. Use one of: "
            f"{', '.join(fitting_methods(layout))}"
        )
    return FAMILIES[entry.family](entry, layout, group, step, options)
