# SPDX-License-Identifier: Apache-2.0
"""The motion groups, and what a sweep asks of the group of a link.

A new lower pair is a file of this folder and its line in GROUPS. A file has the data of its group and
the functions of SPACE that it does not share with others:

    JOINTS           types of joints that it is made for
    COMPONENTS       of a twist: which one each freedom is, S has unit columns
    ORDER            in which the freedoms are eliminated; without it: as they come
    MAY_BE_HELD      True if stops and friction may hold its freedoms
    PLANE_COMPONENTS those of a planar mechanism; without it: none has such a joint

Every function takes the record of the link first (formulations/relative/arrays.LINK). The functions
of this module call that of its group. They are inlined, so that sweeps pay for a branch, no call.
"""

from collections import Counter

from liegroup_core.compiling import kernel

from . import ball, cylinder, derived, free, hinge, plane, screw, slide

# The code of a group is its place.
GROUPS = (hinge, slide, screw, cylinder, plane, ball, free)
HINGE, SLIDE, SCREW, CYLINDER, PLANE, BALL, FREE = range(len(GROUPS))

COMPONENTS = tuple(group.COMPONENTS for group in GROUPS)
FREEDOMS = tuple(map(len, COMPONENTS))
ORDERS = tuple(getattr(group, "ORDER", tuple(range(len(group.COMPONENTS)))) for group in GROUPS)
PLANE_COMPONENTS = {
    code: group.PLANE_COMPONENTS
    for code, group in enumerate(GROUPS)
    if hasattr(group, "PLANE_COMPONENTS")
}
OF_JOINT = {kind: code for code, group in enumerate(GROUPS) for kind in group.JOINTS}

# Function: its arguments after the link.
SPACE = {
    "relative_pose": "coordinates, row",  # pose T X of the link in its parent
    "project_pose": "rot, p, coordinates, row",  # X nearest to a pose in the joint's frame
    "rate_twist": "rates, row",  # S qdot
    "add_rates": "sw, sv, w, v",  # V and [V, S qdot]
    "displace": "coordinates, row, screws, at, out",  # X exp(Psi); its squared angle
    "normalise": "coordinates, row",  # X without round-off
    "slope": "first, b, u, rates, row, slopes, at",  # dexp^-1 of the rates, where that is curved
    "move": "psi, at",  # displacement of a RATTLE step: rotation vector, shift
    "move_coordinates": "coordinates, row, psi, at, out",  # X displaced by it
    "eliminate": "work, f, m, torque, force",  # inertia and bias force without the freedoms
    "hand_on": "work, b, m, torque, force",  # what is left, added to the parent in a short form
    "accelerate": "work, f, w, v",  # acceleration with that of the freedoms
    "leave": "work, f, place, rows, torque, force",  # a wrench without them, and its responses
}


def _derived(group, code):
    """{name: function} of a group that its data determine."""
    components, order = COMPONENTS[code], ORDERS[code]
    may_be_held = getattr(group, "MAY_BE_HELD", False)
    return {
        "rate_twist": derived.twist_of(components, derived.in_row),
        "move": derived.twist_of(components, derived.in_column),
        "move_coordinates": group.displace,
        "slope": None,
        "add_rates": derived.add_rates,
        "eliminate": derived.elimination_of(components, order, may_be_held),
        "hand_on": derived.hand_on,
        "accelerate": derived.acceleration_of(components, order),
        "leave": derived.leaving_of(components, order, may_be_held),
    }


def functions_of(code):
    """{name: function} of a group; None where sweeps never ask."""
    group = GROUPS[code]
    general = _derived(group, code)
    return {name: getattr(group, name, general.get(name)) for name in SPACE}


def _kernel(name, arguments, lines, called):
    """Kernel of generated text. The name of this file makes it one of the sources."""
    text = f"def {name}(link{arguments and ', '}{arguments}):\n" + "".join(
        f"    {line}\n" for line in lines
    )
    names = called | {"__name__": __name__}
    exec(compile(text, __file__, "exec"), names)
    return kernel(names[name])


def choice(name, arguments, functions):
    """Kernel that calls the function for the group of a link; functions: {code: function}.

    What most groups share comes last, once: the machine code of all is in every caller.
    """
    count = Counter(functions.values())
    last = max(reversed(functions.values()), key=count.get)
    called = {f"_{code}": function for code, function in functions.items()}
    lines = [
        f'if link["group"] == {code}: return _{code}(link, {arguments})'
        for code, function in functions.items()
        if function is not last
    ]
    called["_last"] = last
    return _kernel(name, arguments, [*lines, f"return _last(link, {arguments})"], called)


_FUNCTIONS = [functions_of(code) for code in range(len(GROUPS))]


def _chosen(name):
    functions = {code: each[name] for code, each in enumerate(_FUNCTIONS)}
    return choice(name, SPACE[name], {code: f for code, f in functions.items() if f is not None})


relative_pose, project_pose = _chosen("relative_pose"), _chosen("project_pose")
rate_twist, add_rates = _chosen("rate_twist"), _chosen("add_rates")
displace, normalise, slope = _chosen("displace"), _chosen("normalise"), _chosen("slope")
move, move_coordinates = _chosen("move"), _chosen("move_coordinates")
eliminate, hand_on = _chosen("eliminate"), _chosen("hand_on")
accelerate, leave = _chosen("accelerate"), _chosen("leave")

# Whether dexp is not the identity.
_CURVED = [code for code, each in enumerate(_FUNCTIONS) if each["slope"] is not None]
is_curved = _kernel(
    "is_curved", "", ["return " + " or ".join(f'link["group"] == {code}' for code in _CURVED)], {}
)

# S qdot of a link of a planar mechanism, whose slides move along x, as a twist in space.
plane_rate_twist = choice(
    "plane_rate_twist",
    "rates, row",
    {
        code: derived.twist_of(components, derived.in_row)
        for code, components in PLANE_COMPONENTS.items()
    },
)
