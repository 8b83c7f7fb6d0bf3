# SPDX-License-Identifier: Apache-2.0
"""Source text of the functions of a motion group, generated from its data in the same way for all groups.

The data are the components of a twist that are degrees of freedom (COMPONENTS), the order of their elimination (ORDER)
and whether stops and friction may hold them (MAY_BE_HELD). table.py combines the texts of all groups into
one function. A kernel for every group would double the time to compile.
"""

import math

from liegroup_core.lie.se3 import se3_ad
from liegroup_core.lie.vec3 import add3, vector3

from . import about_z
from .elimination import (
    WITH_ROTOR,
    WITHOUT,
    accelerate_direction,
    is_held,
    leave_direction,
    load_direction,
    replaced,
    without_helix,
)

# Names that the texts use.
CALLED = {
    "accelerate_direction": accelerate_direction,
    "add3": add3,
    "is_held": is_held,
    "math": math,
    "leave_direction": leave_direction,
    "load_direction": load_direction,
    "se3_ad": se3_ad,
    "store_place": about_z.store_place,
    "turn": about_z.turn,
    "turn_of": about_z.turn_of,
    "vector3": vector3,
    "without_helix": without_helix,
    **{f"without_{k}": without for k, without in enumerate(WITHOUT)},
    **{f"with_rotor_{k}": with_rotor for k, with_rotor in enumerate(WITH_ROTOR)},
}
Z = 5  # component of a translation along z
AT_JOINT = 'return vector3(link["point"])'  # position of T X without a translation


def twist_of(components, number, pitch=False):
    """Text of S q, angular and linear part; number: text of component {k} of q."""
    numbers = [number.format(k=k) for k in range(len(components))]
    parts = [numbers[components.index(c)] if c in components else "0.0" for c in range(6)]
    if 0 in components:
        return f"w = ({', '.join(parts[:3])})\nreturn w, ({', '.join(parts[3:])})"
    # All groups about z begin with the same line, which table.py moves before the choice.
    parts = ["first" if part == numbers[0] else part for part in parts]
    if pitch:
        parts[Z] = " + ".join(['link["pitch"] * first', *(p for p in parts[Z:] if p != "0.0")])
    twist = f"({', '.join(parts[:3])}), ({', '.join(parts[3:])})"
    return f"first = {numbers[0]}\nreturn {twist}"


def _rates_of(components, pitch):
    lines = []
    for k, c in enumerate(components):
        less = ' - link["pitch"] * V[0][2]' if pitch and c == Z else ""
        lines.append(f"rates[row, {k}] = V[{c // 3}][{c % 3}]{less}")
    return "\n".join(lines)


def _own_forces(components, pitch):
    lines = [f"out[f + {k}] = F[{c // 3}][{c % 3}]" for k, c in enumerate(components)]
    if pitch:
        lines[0] += ' + link["pitch"] * F[1][2]'
    return "\n".join(lines)


def _eliminate(components, order, held, pitch):
    lines = []
    for k in order:
        unless = f"if not is_held(work, f + {k}): " if held else ""
        without = f"without_{components[k]}(work"
        if pitch and k == 0:
            without = 'without_helix(work, link["pitch"], link["rotor"]'
        elif len(order) == 1:
            rotor = f'with_rotor_{components[k]}(work, link["rotor"], f + {k}, m, torque, force)'
            lines.append(
                f'if link["rotor"] > 0.0:\n    {unless}m, torque, force = {rotor}\n    return m, torque, force'
            )
        lines.append(f"{unless}m, torque, force = {without}, f + {k}, m, torque, force)")
    return "\n".join([*lines, "return m, torque, force"])


def _accelerate(components, order, pitch):
    lines = []
    for k in reversed(order):
        lines.append(f"rate = accelerate_direction(work, f + {k}, w, v)")
        vector, c = _part(components[k], "w", "v")
        lines.append(f"{vector} = {replaced(vector, c, f'{vector}[{c}] + rate')}")
        if pitch and k == 0:
            lines.append('v = (v[0], v[1], v[2] + link["pitch"] * rate)')
    return "\n".join([*lines, "return w, v"])


def _wrench_without(components, order, held, pitch, one):
    """Text that removes degrees of freedom from a wrench; one: for number {k}, the {position}th, component {y}."""
    lines = []
    for position, k in enumerate(order):
        vector, c = _part(components[k], "w", "v")
        y, vanishes = f"{vector}[{c}]", [f"work.held[f + {k}] == 0.0"] * held
        if len(order) == 1:
            vanishes.append('link["rotor"] == 0.0')
        if pitch and k == 0:
            y, vanishes = f'{y} + link["pitch"] * v[2]', ['link["pitch"] == 0.0', *vanishes]
        lines.append(f"w, v = {one.format(k=k, position=position, y=y)}")
        left = f"0.0 if {' and '.join(vanishes)} else {vector}[{c}]" if vanishes else "0.0"
        lines.append(f"{vector} = {replaced(vector, c, left)}")
    return "\n".join([*lines, "return w, v"])


def _part(c, angular, linear):
    """Name of the part of a twist or wrench that has component c, and its number there."""
    return (angular, c) if c < 3 else (linear, c - 3)


def _on_coordinates_about_z(components, pitch):
    """Functions on coordinates (cos, sin, x, y, z).

    Without `displace` if the group rotates and translates along x or y, because its exponential couples them.
    """
    turns, shifts = 2 in components, [c for c in components if c > 2]
    kept = ", ".join(f"p[{c - 3}]" if c in components else "0.0" for c in (3, 4, 5))
    functions = {
        "coordinate": "return math.atan2(coordinates[row, 1], coordinates[row, 0])"
        if turns
        else "return coordinates[row, 4]",
        "relative_rotation": about_z.relative_rotation,
        "relative_point": about_z.relative_point if shifts or pitch else AT_JOINT,
        "project_pose": f"c, s = {'turn_of(rot)' if turns else '1.0, 0.0'}\n"
        f"store_place(c, s, {kept}, coordinates, row)",
        "lift": "return",
        "normalise": about_z.normalise if turns else "return",
    }
    moves = [f"out[row, {c - 1}] = coordinates[row, {c - 1}] + screws[at + {components.index(c)}, 0]" for c in shifts]
    if pitch:
        shift = ['link["pitch"] * screws[at, 0]', *(move.split(" + ", 1)[1] for move in moves)]
        moves = [f"out[row, 4] = coordinates[row, 4] + ({' + '.join(shift)})"]
    if not turns:
        lines = ["out[row, 0], out[row, 1] = 1.0, 0.0", *moves, "return 0.0"]
        return functions | {"displace": "\n".join(lines)}
    if shifts in ([], [Z]):
        # One text for all of them: the exponential of the rotation is compiled once.
        functions["lift"] = "\n".join(moves or ["return"])
        functions["displace"] = (
            "square = turn(link, coordinates, row, screws, at, out)\n"
            "lift(link, coordinates, row, screws, at, out)\nreturn square"
        )
    return functions


def functions_of(components, order, held, pitch):
    """{name: function or its text} of a group, see table.SPACE."""
    data, at = (components, order, held, pitch), "place + {position} * rows"
    coordinates = {"relative_point": AT_JOINT, "lift": "return"}
    if 0 not in components:
        coordinates = _on_coordinates_about_z(components, pitch)
    return {
        "rate_twist": twist_of(components, "rates[row, {k}]", pitch),
        "column_twist": twist_of(components, "psi[at + {k}, 0]", pitch),
        "add_rates": "w, v = add3(w, sw), add3(v, sv)\nreturn (w, v), se3_ad(w, v, sw, sv)",
        "rates_of": _rates_of(components, pitch),
        "own_forces": _own_forces(components, pitch),
        "eliminate": _eliminate(components, order, held, pitch),
        "hand_on": "return False, torque, force",
        "accelerate": _accelerate(components, order, pitch),
        "leave": _wrench_without(*data, f"leave_direction(work, f + {{k}}, {{y}}, {at}, w, v)"),
        "load_freedoms": _wrench_without(*data, "load_direction(work, f + {k}, {y}, w, v)"),
        **coordinates,
    }
