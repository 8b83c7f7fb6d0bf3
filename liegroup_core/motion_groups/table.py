# SPDX-License-Identifier: Apache-2.0
"""The motion groups, and the functions that sweeps call for the group of a link.

A new lower pair needs a file in this folder and an entry in _LIST. The file has the data of the group and
the functions of SPACE that it does not share with other groups:

    NAME             that users see
    JOINTS           joint types with this group: {type: motion that it allows, as text}
    COMPONENTS       of a twist that are degrees of freedom; S has unit columns
    ORDER            of elimination of the degrees of freedom; default: as in COMPONENTS
    HAS_PITCH        True if its first degree of freedom includes a translation of link["pitch"] m/rad
    MAY_BE_HELD      True if stops and friction may hold its degrees of freedom
    IN_WORLD_AXES    True if velocities on the group are in world axes: see direct.py
    PLANE_COMPONENTS components in a planar mechanism; without them, none has such a joint. Functions of
                     IN_PLANE that the group does not share with others begin with plane_

Every function takes the record of the link first (mechanism/arrays.LINK). The functions of this module call
that of the link's group. They are inlined, so that sweeps pay for a branch but not for a call.
"""

from collections import Counter
from textwrap import indent

from liegroup_core.compiling import kernel

from . import ball, cylinder, derived, direct, free, hinge, in_plane, plane, screw, slide
from .elimination import made

# All groups, in the order of texts for users.
_LIST = (ball, hinge, slide, cylinder, plane, screw, free, direct)
# The code of a group is its index here; groups that do not rotate, or only about z, come first.
GROUPS = tuple(sorted(_LIST, key=lambda group: 0 in group.COMPONENTS))
HINGE, SLIDE, PLANE, FREE, DIRECT = map(GROUPS.index, (hinge, slide, plane, free, direct))
JOINTS = {name: group for group in _LIST for name in group.JOINTS}

# Groups of SE(3)^n and (SO(3) x R^3)^n, on which all bodies float.
FLOATING = {"se3": FREE, "so3xr3": DIRECT}

COMPONENTS = tuple(group.COMPONENTS for group in GROUPS)
FIRST_OF_ALL_AXES = next(code for code, components in enumerate(COMPONENTS) if 0 in components)
FREEDOMS = tuple(map(len, COMPONENTS))
ORDERS = tuple(getattr(group, "ORDER", range(len(group.COMPONENTS))) for group in GROUPS)
PLANE_COMPONENTS = {
    code: group.PLANE_COMPONENTS for code, group in enumerate(GROUPS) if hasattr(group, "PLANE_COMPONENTS")
}
OF_JOINT = {kind: GROUPS.index(group) for kind, group in JOINTS.items()}

# Function: its arguments after the link.
SPACE = {
    "relative_rotation": "coordinates, row",  # of the pose T X of the link in its parent
    "relative_point": "coordinates, row",  # its position
    "project_pose": "rot, p, coordinates, row",  # X nearest to a pose in the joint's frame
    "coordinate": "coordinates, row",  # angle in [-pi, pi], or displacement of a slide
    "rate_twist": "rates, row",  # S qdot
    "rates_of": "V, rates, row",  # qdot of a twist S qdot
    "own_forces": "F, out, f",  # S^T F
    "add_rates": "sw, sv, w, v",  # V and [V, S qdot]
    "displace": "coordinates, row, screws, at, out",  # X exp(Psi); its squared angle
    "displace_by_twist": "coordinates, row, screws, at, out",  # the same for Psi in link axes
    "lift": "coordinates, row, screws, at, out",  # its translation along z, for groups that also rotate
    "normalise": "coordinates, row",  # X without round-off
    "slope": "first, b, u, rates, row, slopes, at",  # dexp^-1 of the rates, where dexp is not the identity
    "column_twist": "psi, at",  # S psi for a column psi; a displacement as rotation vector and shift
    "move_coordinates": "coordinates, row, psi, at, out",  # X displaced by that
    "eliminate": "work, f, m, torque, force",  # inertia and bias force without the degrees of freedom
    "hand_on": "work, b, m, torque, force",  # the rest, added to the parent in a short form
    "accelerate": "work, f, w, v",  # acceleration with that of the degrees of freedom
    "leave": "work, f, place, rows, w, v",  # a wrench without them, and its responses
    "load_freedoms": "work, f, w, v",  # the same with u of the degrees of freedom for the wrench -(w, v)
}
# The same for a planar mechanism: see in_plane.py.
IN_PLANE = {
    **{name: SPACE[name] for name in ("project_pose", "coordinate", "rate_twist", "displace")},
    **{name: SPACE[name] for name in ("rates_of", "own_forces")},
    **{name: SPACE[name] for name in ("normalise", "column_twist", "move_coordinates")},
    "add_rates": "S, V",  # V and the translation of [V, S qdot]
    "eliminate": "work, f, m, F",  # inertia and bias force without the degrees of freedom; or hand_on does it
    "hand_on": "work, row, m, F",  # the rest, added to the parent
    "accelerate": "work, f, E, V",  # acceleration with that of the degrees of freedom; E of the parent
    "leave": "work, f, row, F",  # a wrench without them, in the axes of the parent; its responses
}


def functions_of(group):
    """{name: function of a group, or its text}; only the functions that sweeps call for it."""
    order = getattr(group, "ORDER", range(len(group.COMPONENTS)))
    held, pitch = getattr(group, "MAY_BE_HELD", False), getattr(group, "HAS_PITCH", False)
    found = derived.functions_of(group.COMPONENTS, order, held, pitch)
    return found | {name: getattr(group, name) for name in SPACE if hasattr(group, name)}


def choice(name, arguments, functions):
    """Kernel that calls the function for the group of a link; functions: {code: function or text}.

    Groups that rotate about all axes are branched off first, if then one of both sides shares text.
    """
    called, bodies = derived.CALLED | in_plane.CALLED, {}
    for code, function in functions.items():
        if not isinstance(function, str):
            own = f"_{list(functions.values()).index(function)}"
            called[own], function = function, f"return {own}(link, {arguments})"
        bodies[code] = function if "return" in function else f"{function}\nreturn"
    about_z = {code: body for code, body in bodies.items() if code < FIRST_OF_ALL_AXES}
    others = {code: body for code, body in bodies.items() if code >= FIRST_OF_ALL_AXES}
    apart = about_z and others and not set(about_z.values()) & set(others.values())
    if apart and (_is_shared(about_z) or _is_shared(others)):
        split = f'if link["group"] >= {FIRST_OF_ALL_AXES}:\n{indent(_chain(others), "    ")}\n'
        return _kernel(name, f"link, {arguments}", split + _chain(about_z), called)
    return _kernel(name, f"link, {arguments}", _chain(bodies), called)


def _is_shared(bodies):
    """Whether some of several texts are the same, or all begin alike."""
    texts = set(bodies.values())
    alike = len({text.partition("\n")[0] for text in texts}) == 1
    return len(bodies) > 1 and (alike or len(texts) < len(bodies))


def _chain(bodies):
    """Text that selects one of several texts by the group; bodies: {code: text}.

    The text that most groups share comes last, once, because the machine code of all is in every caller. A
    first line that all share comes before the choice.
    """
    count = Counter(bodies.values())
    first = {body.partition("\n")[0] for body in count}
    if len(first) == 1 and len(count) > 1:
        rest = {code: body.partition("\n")[2] for code, body in bodies.items()}
        return f"{first.pop()}\n{_chain(rest)}"
    last = max(reversed(bodies.values()), key=count.get)
    lines = []
    for body in count:
        if body != last:
            lines.append(f"if {_is_any(code for code in bodies if bodies[code] == body)}:")
            lines.append(indent(body, "    "))
    return "\n".join([*lines, last])


def _is_any(codes):
    """Text of the condition that the link has one of these groups."""
    return " or ".join(f'link["group"] == {code}' for code in codes)


def _kernel(name, arguments, body, called):
    text = f"def {name}({arguments}):\n{indent(body, '    ')}\n"
    return made(name, text, called | {"__name__": __name__})


_FUNCTIONS = list(map(functions_of, GROUPS))


def _chosen(name, other=None):
    """Kernel of SPACE; other: for groups without this function."""
    functions = {code: each.get(name, other) for code, each in enumerate(_FUNCTIONS)}
    missing = [GROUPS[code].__name__ for code in functions if functions[code] is None]
    if missing:
        raise TypeError(f"no function {name}: {', '.join(missing)}")
    return choice(name, SPACE[name], functions)


derived.CALLED["lift"] = _chosen("lift")
displace = _chosen("displace")
displace_by_twist = _chosen("displace_by_twist", displace)
_WITH = [code for code, each in enumerate(_FUNCTIONS) if "coordinate" in each]
coordinate = choice("coordinate", SPACE["coordinate"], {c: _FUNCTIONS[c]["coordinate"] for c in _WITH})
relative_rotation, relative_point = _chosen("relative_rotation"), _chosen("relative_point")
project_pose, normalise = _chosen("project_pose"), _chosen("normalise")
rate_twist, add_rates = _chosen("rate_twist"), _chosen("add_rates")
rates_of, own_forces = _chosen("rates_of"), _chosen("own_forces")
column_twist, move_coordinates = _chosen("column_twist"), _chosen("move_coordinates", displace)
eliminate, hand_on = _chosen("eliminate"), _chosen("hand_on")
accelerate, leave = _chosen("accelerate"), _chosen("leave")
load_freedoms = _chosen("load_freedoms")


@kernel
def relative_pose(link, coordinates, row):
    """Pose T X of a link in its parent link: rotation, position in m."""
    return relative_rotation(link, coordinates, row), relative_point(link, coordinates, row)


# Groups whose dexp is not the identity; only these have a slope.
_CURVED = {code: each["slope"] for code, each in enumerate(_FUNCTIONS) if "slope" in each}
is_curved = _kernel("is_curved", "link", f"return {_is_any(_CURVED)}", {})
slope = choice("slope", SPACE["slope"], _CURVED)

_DIRECT = [code for code, group in enumerate(GROUPS) if getattr(group, "IN_WORLD_AXES", False)]
in_world_axes = _kernel("in_world_axes", "link", f"return {_is_any(_DIRECT)}", {})
# Whether the first degree of freedom is a translation.
_SLIDING = [code for code, components in enumerate(COMPONENTS) if components[0] > 2]
slides = _kernel("slides", "link", f"return {_is_any(_SLIDING)}", {})


def plane_functions_of(code):
    """{name: function of a group in a plane, or its text}; only the functions that sweeps call for it."""
    own = {name: getattr(GROUPS[code], f"plane_{name}", None) for name in IN_PLANE}
    found = in_plane.functions_of(PLANE_COMPONENTS[code])
    return found | {name: function for name, function in own.items() if function is not None}


_PLANE_FUNCTIONS = {code: plane_functions_of(code) for code in PLANE_COMPONENTS}


def _in_plane(name, other=None):
    """Kernel of IN_PLANE."""
    functions = {code: each.get(name, each.get(other)) for code, each in _PLANE_FUNCTIONS.items()}
    return choice(f"plane_{name}", IN_PLANE[name], {c: each for c, each in functions.items() if each})


plane_project_pose, plane_coordinate = _in_plane("project_pose"), _in_plane("coordinate")
plane_rate_twist, plane_add_rates = _in_plane("rate_twist"), _in_plane("add_rates")
plane_rates_of, plane_own_forces = _in_plane("rates_of"), _in_plane("own_forces")
plane_displace, plane_normalise = _in_plane("displace"), _in_plane("normalise")
plane_displace_by_twist = plane_displace
plane_column_twist = _in_plane("column_twist")
plane_move_coordinates = _in_plane("move_coordinates", "displace")
plane_eliminate, plane_hand_on = _in_plane("eliminate"), _in_plane("hand_on")
plane_accelerate, plane_leave = _in_plane("accelerate"), _in_plane("leave")


def by_model(name):
    """Kernels (model, link, ...) of a function in space and in a plane, to be selected by the model."""
    arguments = SPACE["displace" if name == "displace_by_twist" else name]
    text = f"return function(link, {arguments})"
    each = (globals()[name], globals()[f"plane_{name}"])
    return [_kernel(name, f"model, link, {arguments}", text, {"function": f}) for f in each]
