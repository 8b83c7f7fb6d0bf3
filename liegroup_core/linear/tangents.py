# SPDX-License-Identifier: Apache-2.0
"""Tangents of the equations of motion: derivatives of the accelerations along directions of the state and inputs.

A direction displaces link b by S psi in its joint and changes its rates by w. With twists, wrenches and
accelerations (minus gravity) in link axes, P = X V_a and B = X Vdot_a of the parent a, from the world to the leaves

    eta_b   = X eta_a + S psi
    dV_b    = X dV_a + [P, S psi] + S w
    dVdot_b = X dVdot_a + [B, S psi] + [dV_b, S qdot] + [V_b, S w]        for qddot that do not change

With V* F = (omega x torque + v x force, omega x force), the wrench of a link is F = I Vdot + V* I V, and

    dF_b = I dVdot_b + dV_b* I V_b + V_b* I dV_b

The wrench T_c that child c transmits turns with it, which adds X^-T (S psi_c)* T_c to its parent. A row
J (V_b - X V_a) of a cut joint sees the displacement kappa = X eta_a - eta_b of its parent: d(X V_a) = X dV_a + [kappa,
X V_a]. The residuals that result are those of the sweeps in residuals.py, and are solved with the factors that the
accelerations of the state have left, and are refined as those: O(n) for a direction, no factor is computed again.

Forces have their own derivatives (`add_changes` of forces/kinds.py). Of rows other than pairs, functions of the pose of
a cut joint, differences of order six are taken (differences.py).
"""

import numpy as np

from liegroup_core.compiling import borrowed, kernel, subroutine
from liegroup_core.dynamics.accelerations import apply_forces, balance
from liegroup_core.dynamics.algebra import (
    Ad_inverse,
    add,
    add_row,
    add_to,
    choice,
    column_twist,
    freed,
    link_of,
    load,
    product,
    rate_twist,
    rates_of,
    relative,
    resting,
    spatial,
    store,
    sub,
    wrench_at,
    zero,
)
from liegroup_core.dynamics.coordinates import place_links
from liegroup_core.dynamics.coupled_rows import slopes_of
from liegroup_core.dynamics.couplings import add_coupling, add_pair, add_rotors, coupled_rate
from liegroup_core.dynamics.links import body_wrench, momentum, seen_from
from liegroup_core.dynamics.loops import close_loops
from liegroup_core.dynamics.matrix import NEAR, has_small_pivot, is_off
from liegroup_core.dynamics.residuals import add_multipliers, add_own_forces, gather_forces
from liegroup_core.dynamics.switches import side_of
from liegroup_core.dynamics.trees import move_links, spread_response
from liegroup_core.forces.external import set_changes
from liegroup_core.forces.kinds import add_changes
from liegroup_core.joints.elements import PAIR, WORLD
from liegroup_core.joints.kinds import variable_row
from liegroup_core.lie.se2 import se2_Ad, turn_back2
from liegroup_core.lie.se3 import se3_Ad, se3_ad, se3_Ad_inverse
from liegroup_core.lie.so3 import so3_exp
from liegroup_core.lie.vec3 import (
    ZERO3,
    add3,
    axpy3,
    cross3,
    dot3,
    load3,
    matmul3,
    matrix3,
    matvec3,
    store3,
    sub3,
    tmatvec3,
    vector3,
)
from liegroup_core.mechanism.arrays import RESTS
from liegroup_core.mechanism.bodies import PIVOT
from liegroup_core.methods.munthe_kaas import steps
from liegroup_core.status import DEPENDENT_ROWS, OK

NOT_REGULAR = -1  # near a singular pose: the accelerations are those of displaced poses
NOT_SMOOTH = 1.0  # of errors: differences of a row have no digits
SIZES = 4  # of differences, each SMALLER times the one before
SMALLER, ENOUGH = 0.125, 1e-12
ROUND_OFF = 4.0 * np.finfo(float).eps
# Arrays (L, 6) of links, and arrays (m,) of rows.
ACCELERATION, WRENCH, ETA, TWIST, MOVED, SCREW, RATE, STILL, FORCE = range(9)
RIGHT, MULTIPLIER, SLIP, SHIFT = range(4)


@kernel
def _bracket_in_space(model, V, W):
    return se3_ad(V[0], V[1], W[0], W[1])


@kernel
def _bracket_in_plane(model, V, W):
    return 0.0, W[0] * V[2] - V[0] * W[2], V[0] * W[1] - W[0] * V[1]


@kernel
def _dual_in_space(model, V, F):
    return add3(cross3(V[0], F[0]), cross3(V[1], F[1])), cross3(V[0], F[1])


@kernel
def _dual_in_plane(model, V, F):
    return V[1] * F[2] - V[2] * F[1], -V[0] * F[2], V[0] * F[1]


@kernel
def _Ad_in_space(model, X, V):
    return se3_Ad(X[0], X[1], V[0], V[1])


@kernel
def _Ad_in_plane(model, X, V):
    return se2_Ad(X, V)


@kernel
def _Ad_transpose_in_space(model, X, F):
    return tmatvec3(X[0], sub3(F[0], cross3(X[1], F[1]))), tmatvec3(X[0], F[1])


@kernel
def _Ad_transpose_in_plane(model, X, F):
    x, y = turn_back2(X[0], X[1], F[1], F[2])
    return F[0] - (X[2] * F[2] - X[3] * F[1]), x, y


@kernel
def _at_own_points(model, cut, K):
    """A ball joint moves its parent so that the joint points coincide; see rows.py."""
    if cut["parent"] == WORLD or cut["own_points"] == 0:
        return K
    return K[0], cross3(vector3(model.elements[cut["element"]]["child_point"]), K[0])


@kernel
def _as_it_is(model, cut, K):
    return K


@kernel
def _turned_in_space(model, cut, C, V, W, e):
    turn = V[0]
    if cut["parent"] != WORLD and cut["own_points"] == 1:
        turn = add3(V[0], W[0])
    return C[0], add3(C[1], cross3(turn, e[1]))


@kernel
def _turned_in_plane(model, cut, C, V, W, e):
    return C[0], C[1] - V[0] * e[2], C[2] + V[0] * e[1]


@kernel
def _times_in_space(model, factor, V):
    return axpy3(factor, V[0], ZERO3), axpy3(factor, V[1], ZERO3)


@kernel
def _times_in_plane(model, factor, V):
    return axpy3(factor, V, ZERO3)


@kernel
def _row_in_space(model, rows, r):
    return load3(rows, r, 0), load3(rows, r, 3)


@kernel
def _row_in_plane(model, rows, r):
    return load3(rows, r, 2)


# [V, W]; V* F; Ad_X V; Ad_X^T F; kappa of a row; V and e in the bias of a row.
_bracket = choice("bracket", _bracket_in_space, _bracket_in_plane)
_dual = choice("dual", _dual_in_space, _dual_in_plane)
_Ad = choice("Ad", _Ad_in_space, _Ad_in_plane)
_Ad_transpose = choice("Ad_transpose", _Ad_transpose_in_space, _Ad_transpose_in_plane)
_seen = choice("seen", _at_own_points, _as_it_is)
_turned = choice("turned", _turned_in_space, _turned_in_plane)
_times = choice("times", _times_in_space, _times_in_plane)
_row = choice("row", _row_in_space, _row_in_plane)


@kernel
def _set_state(model, work, pose_in, twist_in, external_in, links, rows, given):
    """Accelerations of the state with their factors, and what tangents need of them. Returns a status."""
    pose, twist, external, _ = steps.enter(model, work, pose_in, twist_in, external_in)
    steps.begin(model, work, pose, twist)
    move_links(model, work)
    place_links(model, work)
    apply_forces(model, work, external)
    dependent = balance(model, work)
    if dependent >= 0:
        return DEPENDENT_ROWS + (model.owners[dependent] << 8)
    for f in range(len(work.acceleration)):
        given[f, 0] = work.acceleration[f, 0]
    for r in range(len(work.multipliers)):
        rows[MULTIPLIER, r] = work.multipliers[r]
    L = len(model.links)
    for b in range(L):
        store(model, freed(model, work, b), links, ACCELERATION * L + b)
        store(model, zero(model), work.force, b)
    add_own_forces(model, work)
    add_multipliers(model, work)
    for b in range(L):
        store(model, load(model, work.force, b), links, WRENCH * L + b)
    for b in range(len(model.links) - 1, -1, -1):
        a = model.links[b]["parent"]
        if a != WORLD:
            F = wrench_at(model, relative(model, work, b), load(model, links, WRENCH * L + b))
            add_to(model, F, links, WRENCH * L + a)
    return OK


@kernel
def _displace_links(model, work, moves, at, links):
    """Displacements, and changes of twists and accelerations, of all links, and of their wrenches in work.force.

    moves : psi of all freedoms from row `at` on, then w
    """
    n, L, f_all, nothing, rest = len(model.bodies), len(model.links), len(work.freedoms), zero(model), resting(model)
    for b in range(L):
        store(model, nothing, work.force, b)
    for b in range(L):
        link = link_of(model, b)
        a, f = link["parent"], at + link["freedom"]
        still = True
        for k in range(link["freedoms"]):
            still = still and moves[f + k, 0] == moves[f + f_all + k, 0] == 0.0
        still = still and (a == WORLD or links[STILL * L + a, 0] == 1.0)
        links[STILL * L + b, 0] = 1.0 if still else 0.0
        if still:
            for c in (SCREW, ETA, TWIST, MOVED):
                store(model, nothing, links, c * L + b)
            continue
        X = relative(model, work, b)
        own, rate = column_twist(model, link, moves, f), column_twist(model, link, moves, f + f_all)
        V, S = load(model, work.velocities, b), rate_twist(model, link, work.stage_twist, n + b)
        e, dV, dA, B = own, rate, nothing, rest
        if a != WORLD:
            P = Ad_inverse(model, X, load(model, work.velocities, a))
            e = add(model, e, Ad_inverse(model, X, load(model, links, ETA * L + a)))
            dV = add(model, dV, Ad_inverse(model, X, load(model, links, TWIST * L + a)))
            dV = add(model, dV, _bracket(model, P, own))
            dA = Ad_inverse(model, X, load(model, links, MOVED * L + a))
            B = load(model, links, ACCELERATION * L + a)
        dA = add(model, dA, _bracket(model, Ad_inverse(model, X, B), own))
        dA = add(model, dA, add(model, _bracket(model, dV, S), _bracket(model, V, rate)))
        store(model, own, links, SCREW * L + b)
        store(model, e, links, ETA * L + b)
        store(model, dV, links, TWIST * L + b)
        store(model, dA, links, MOVED * L + b)
        F = add(model, momentum(model, link, dA), _dual(model, dV, momentum(model, link, V)))
        F = add(model, F, _dual(model, V, momentum(model, link, dV)))
        add_to(model, F, work.force, b)
        if a != WORLD:
            F = wrench_at(model, X, _dual(model, own, load(model, links, WRENCH * L + b)))
            add_to(model, F, work.force, a)


@kernel
def _begin(orders, count):
    for c in range(count):
        orders[0, c] = orders[1, c] = orders[2, c] = 0.0


@kernel
def _add_value(orders, c, k, value):
    """Add a value at (k + 1) h, over h, to the formulas of orders 2, 4 and 6 for entry c."""
    if k == 0:
        orders[0, c] += 0.5 * value
        orders[1, c] += (2.0 / 3.0) * value
        orders[2, c] += 0.75 * value
    elif k == 1:
        orders[1, c] -= value / 12.0
        orders[2, c] -= 0.15 * value
    else:
        orders[2, c] += value / 60.0


@kernel
def _error_of(orders, count, most, size):
    """Error of the formulas of order six, or NOT_SMOOTH; see differences.py.

    most, size : largest of the added values, and h
    The error is relative to the largest entry, or to the largest value if that is larger.
    """
    error = largest = 0.0
    for c in range(count):
        last, before = abs(orders[2, c] - orders[1, c]), abs(orders[1, c] - orders[0, c])
        error = max(error, last * min(1.0, last / before) if before > 0.0 else last)
        largest = max(largest, abs(orders[2, c]))
    if error <= max(ENOUGH * largest, ROUND_OFF * most):
        return error / max(largest, most * size) if error > 0.0 else 0.0
    return NOT_SMOOTH


@kernel
def _change_wrenches(model, work, external, more, targets, d, directions, links, moves, rates):
    """Add the changes of the wrenches of all forces to work.force.

    more, targets : changes of the external wrenches, and of the targets of servos, of all directions d
    directions    : of all freedoms, see `tangents`
    moves, rates : scratch memory (n, 6)
    """
    L, n = len(model.links), len(model.bodies)
    for i in range(n):
        body, b, e, dV = model.bodies[i], model.bodies[i]["link"], (ZERO3, ZERO3), (ZERO3, ZERO3)
        if b != WORLD and links[STILL * L + b, 0] == 0.0:
            rot, point = matrix3(body["rotation"]), vector3(body["point"])
            e = spatial(model, load(model, links, ETA * L + b))
            dV = spatial(model, load(model, links, TWIST * L + b))
            e, dV = se3_Ad_inverse(rot, point, e[0], e[1]), se3_Ad_inverse(rot, point, dV[0], dV[1])
        store3(e[0], moves, i, 0)
        store3(e[1], moves, i, 3)
        store3(dV[0], rates, i, 0)
        store3(dV[1], rates, i, 3)
    pose, twist, forces = work.space.stage_pose, work.space.stage_twist, model.space.forces
    set_changes(external, more, d * n, pose, twist, moves, rates, work.wrench)
    if forces.exist:
        at = d * len(work.targets)
        laws, f_all = forces.laws, len(work.freedoms)
        for s in range(len(model.law_links)):  # time and states are those of the accelerations
            link = model.links[model.law_links[s]]
            work.registers[laws.states[s, 0], 1] = directions[(2 * d + 1) * f_all + link["freedom"], 0]
        given = forces, work.angle, work.targets, work.registers
        add_changes(*given, pose, twist, moves, rates, targets, at, work.wrench)
        for s in range(len(model.law_links)):
            add_pair(model, work, model.law_links[s], 0, -work.registers[laws.states[s, 1], 1], work.force, 1)
    for i in range(n):
        b = model.bodies[i]["link"]
        if b != WORLD:
            add_to(model, _times(model, -1.0, body_wrench(model, work, i)), work.force, b)


@kernel
def _difference_row(element, X, error, K, change, orders, size):
    """Write the changes of a row that is not a pair, and of its rate, to orders[2, :7]. Returns their error."""
    found = NOT_SMOOTH
    for _ in range(SIZES):
        _begin(orders, 7)
        most = 0.0
        for p in range(6):
            k = p // 2
            sign = 1.0 if p % 2 == 0 else -1.0
            s = sign * (k + 1.0) * size
            turn = so3_exp((s * K[0][0], s * K[0][1], s * K[0][2]))
            rot, point = matmul3(turn, X[0]), axpy3(s, K[1], matvec3(turn, X[1]))
            w, v = axpy3(s, change[0], error[0]), axpy3(s, change[1], error[1])
            alpha, beta, rate = variable_row(element, rot, point, w, v)
            for c in range(3):
                _add_value(orders, c, k, sign * alpha[c] / size)
                _add_value(orders, 3 + c, k, sign * beta[c] / size)
                most = max(most, max(abs(alpha[c]), abs(beta[c])) / size)
            _add_value(orders, 6, k, sign * rate / size)
            most = max(most, abs(rate) / size)
        found = _error_of(orders, 7, most, size)
        if found != NOT_SMOOTH:
            break
        size *= SMALLER
    return found


@kernel
def _change_variable_row(model, work, cut, X, error, change, K, Y, rows, orders, size):
    """Add what a change of a row J that is not a pair adds: to the residual and its slip, and to work.force.

    Y : what J multiplies in the residual
    returns the error
    """
    a, b, r = cut["parent"], cut["child"], cut["first"]
    found = _difference_row(model.elements[cut["element"]], X, error, K, change, orders, size)
    alpha, beta = (orders[2, 0], orders[2, 1], orders[2, 2]), (orders[2, 3], orders[2, 4], orders[2, 5])
    rows[RIGHT, r] += dot3(alpha, Y[0]) + dot3(beta, Y[1]) + orders[2, 6]
    rows[SLIP, r] += dot3(alpha, error[0]) + dot3(beta, error[1])
    F = _times(model, rows[MULTIPLIER, r], (alpha, beta))
    add_to(model, F, work.force, b)
    if a != WORLD:
        add_to(model, _times(model, -1.0, _Ad_transpose(model, X, F)), work.force, a)
    return found


@kernel
def _no_change(model, work, cut, X, error, change, K, Y, rows, orders, size):
    """All rows of a planar mechanism are pairs."""
    return 0.0


_change_row = choice("change_row", _change_variable_row, _no_change)


@kernel
def _change_rows(model, work, links, rows, orders, size):
    """Changes of the residuals of all rows of cut joints, and of their wrenches, to work.force. Returns the error."""
    L, nothing, rest, error = len(model.links), zero(model), resting(model), 0.0
    for j in range(len(model.cuts)):
        cut = model.cuts[j]
        a, b, first = cut["parent"], cut["child"], cut["first"]
        for r in range(first, first + cut["rows"]):
            rows[RIGHT, r] = rows[SLIP, r] = rows[SHIFT, r] = 0.0
        if model.coupling[j] >= 0:
            continue
        V = load(model, work.velocities, b)
        e, dV = load(model, links, ETA * L + b), load(model, links, TWIST * L + b)
        A, dA = load(model, links, ACCELERATION * L + b), load(model, links, MOVED * L + b)
        X, W = seen_from(model, work, cut, a, b)
        K, dW, B, dB = sub(model, nothing, e), nothing, rest, nothing
        if a != WORLD:
            K = _seen(model, cut, add(model, K, _Ad(model, X, load(model, links, ETA * L + a))))
            dW = _Ad(model, X, load(model, links, TWIST * L + a))
            B = load(model, links, ACCELERATION * L + a)
            dB = _Ad(model, X, load(model, links, MOVED * L + a))
        B = _Ad(model, X, B)
        dW, dB = add(model, dW, _bracket(model, K, W)), add(model, dB, _bracket(model, K, B))
        C = add(model, _bracket(model, dV, W), _bracket(model, V, dW))
        slip, F, gap = sub(model, dV, dW), nothing, nothing
        Y = add(model, sub(model, A, B), _bracket(model, V, W))
        if cut["kind"] != PAIR:
            found = _change_row(model, work, cut, X, sub(model, V, W), slip, K, Y, rows, orders, size)
            error = max(error, found)
        for r in range(first, first + cut["rows"]):
            J = _row(model, work.child_jacobian, r)
            rows[SLIP, r] += product(model, 0.0, work.child_jacobian, r, slip)
            rows[SHIFT, r] = -product(model, 0.0, work.child_jacobian, r, K)
            gap = add_row(model, gap, rows[SLIP, r], work.child_jacobian, r)
            F = add(model, F, _times(model, rows[MULTIPLIER, r], J))
        if a != WORLD:
            add_to(model, _Ad_transpose(model, X, _dual(model, K, F)), work.force, a)
        dY = _turned(model, cut, add(model, sub(model, dA, dB), C), V, W, gap)
        for r in range(first, first + cut["rows"]):
            rows[RIGHT, r] += product(model, 0.0, work.child_jacobian, r, dY)
    return error


@kernel
def _change_couplings(model, work, moves, at, rows, given):
    """Changes of the rates of all couplings; of curved ones also of the residuals and forces of their rows."""
    rates = at + len(work.freedoms)
    for c in range(len(model.couplings)):
        coupling = model.couplings[c]
        r = coupling["row"]
        rows[SLIP, r] = coupled_rate(model, work, moves, rates, c)
        rows[SHIFT, r] = coupled_rate(model, work, moves, at, c)
        if coupling["curved"] == 0:
            continue
        term = model.coupling_terms[coupling["terms"][0] + 1]
        b = term["link"]
        f = model.links[b]["freedom"]
        _, bend, third = slopes_of(model, work, coupling)
        speed = work.stage_twist[len(model.bodies) + b, 0]
        factor = -bend * moves[at + f, 0]
        rows[SLIP, r] += factor * speed
        rows[RIGHT, r] += factor * given[f, 0]
        if coupling["order"] == 2:
            turned = term["sign"] * moves[at + f, 0]
            rows[RIGHT, r] -= third * turned * speed * speed + 2.0 * bend * speed * moves[rates + f, 0]
        add_pair(model, work, b, 0, rows[MULTIPLIER, r] * factor, work.force, 1)


@kernel
def _change_switches(model, work, moves, at, rows):
    """Changes of friction and of compliant stops: of freedoms, and of rows that are not held."""
    for k in range(len(model.switches)):
        switch = model.switches[k]
        b, f, r = switch["link"], switch["freedom"], switch["row"]
        if work.modes[k, RESTS] != 0.0 or work.held[f] != 0.0:
            continue
        shift, rate = (
            (moves[at + f, 0], moves[at + len(work.freedoms) + f, 0]) if r < 0 else (rows[SHIFT, r], rows[SLIP, r])
        )
        effort = -switch["viscous"] * rate
        if side_of(model, work, k) != 0.0:
            effort -= switch["stiffness"] * shift + switch["damping"] * rate
        if r < 0:
            add_pair(model, work, b, switch["component"], -effort, work.force, 1)
            continue
        for c in range(len(model.couplings)):
            if model.couplings[c]["row"] == r:
                add_coupling(model, work, c, -effort, work.force, 1)
        cut = model.cuts[_cut_of(model, r)]
        F = _times(model, -effort, _row(model, work.child_jacobian, r))
        add_to(model, F, work.force, cut["child"])
        if cut["parent"] != WORLD:
            F = _times(model, -effort, _row(model, work.parent_jacobian, r))
            add_to(model, F, work.force, cut["parent"])


@kernel
def _cut_of(model, r):
    """Cut joint of row r."""
    for j in range(len(model.cuts)):
        if model.cuts[j]["first"] <= r < model.cuts[j]["first"] + model.cuts[j]["rows"]:
            return j
    return -1


@subroutine
def _respond(model, work, rows, is_correction):
    """Accelerations for the residuals in work.force and in rows, with the factors of the state.

    is_correction : they are added to those in work.total and work.total_moved
    """
    gather_forces(model, work)
    spread_response(model, work)
    if len(model.cuts) > 0:
        if is_correction:
            _add_totals(model, work)
        for j in range(len(model.cuts)):
            cut = model.cuts[j]
            a, b = cut["parent"], cut["child"]
            for r in range(cut["first"], cut["first"] + cut["rows"]):
                value = product(model, rows[RIGHT, r], work.child_jacobian, r, load(model, work.moved, b))
                if a != WORLD:
                    value = product(model, value, work.parent_jacobian, r, load(model, work.moved, a))
                work.right[r] = value
        for c in range(len(model.couplings)):
            row = model.couplings[c]["row"]
            work.right[row] = rows[RIGHT, row] + coupled_rate(model, work, work.acceleration, 0, c)
        close_loops(model, work)
        spread_response(model, work)
    if is_correction:
        _add_totals(model, work)
    return 0


@kernel
def _add_totals(model, work):
    for b in range(len(model.links)):
        add_to(model, load(model, work.total_moved, b), work.moved, b)
    for f in range(len(work.total)):
        work.acceleration[f, 0] += work.total[f, 0]


@kernel
def _solve(model, work, links, rows):
    """Derivatives of the accelerations for the residuals in work.force and in rows, as often refined as those."""
    L, refinements = len(model.links), model.refinements
    for b in range(L):
        store(model, load(model, work.force, b), links, FORCE * L + b)
    for r in range(len(work.multipliers)):
        work.multipliers[r] = 0.0
    _respond(model, work, rows, False)
    if len(model.cuts) > 0 and has_small_pivot(work):
        refinements = max(refinements, 1)
    for _ in range(refinements):
        for f in range(len(work.total)):
            work.total[f, 0] = work.acceleration[f, 0]
        for b in range(L):
            moved = load(model, work.moved, b)
            store(model, moved, work.total_moved, b)
            needed = add(model, load(model, links, FORCE * L + b), momentum(model, link_of(model, b), moved))
            store(model, needed, work.force, b)
        add_multipliers(model, work)
        add_rotors(model, work, work.total, 1.0, work.force)
        _respond(model, work, rows, True)


@kernel
def tangents(model, work, moves, more, targets, sizes, state, links, bodies, rows, orders, given, out):
    """Write the derivatives of psi' and w' along d directions to out (d, 2 f + 1 + m), their error, and those of J V.

    moves (2 d f, 1) : psi of all freedoms, then w, see probe.py, for one direction after the other
    more (d n, COLUMNS), targets (d k, 2) : changes of the inputs
    sizes (d,)  : first distance of differences
    state       : pose, twist, external wrenches
    bodies (2, n, 6), links (9 L, 6), rows (4, m), orders (3, 7), given (f, 1) : scratch memory
    returns a status; NOT_REGULAR: only the derivatives of J V are valid
    """
    moves, more, targets, sizes = borrowed(moves), borrowed(more), borrowed(targets), borrowed(sizes)
    links, rows, orders, given, out = borrowed(links), borrowed(rows), borrowed(orders), borrowed(given), borrowed(out)
    external, body_moves, body_rates = borrowed(state[2]), borrowed(bodies[0]), borrowed(bodies[1])
    status = _set_state(model, work, borrowed(state[0]), borrowed(state[1]), external, links, rows, given)
    if status != OK:
        return status
    is_regular = work.report[PIVOT] >= NEAR
    n, L, f_all = len(model.bodies), len(model.links), len(given)
    applies = model.space.forces.exist or work.pushed[0] > 0.0
    for d in range(len(sizes)):
        at, error, pushes = 2 * d * f_all, 0.0, applies
        _displace_links(model, work, moves, at, links)
        for i in range(n):
            for c in range(6):
                pushes = pushes or more[d * n + i, c] != 0.0
        if pushes:
            _change_wrenches(model, work, external, more, targets, d, moves, links, body_moves, body_rates)
        if len(model.cuts) > 0:
            error = _change_rows(model, work, links, rows, orders, sizes[d])
            _change_couplings(model, work, moves, at, rows, given)
        _change_switches(model, work, moves, at, rows)
        _solve(model, work, links, rows)
        for b in range(L):
            link = link_of(model, b)
            for k in range(link["freedoms"]):
                links[RATE * L + b, k] = 0.0
            if links[STILL * L + b, 0] == 0.0:
                S = rate_twist(model, link, work.stage_twist, n + b)
                rates_of(model, link, _bracket(model, load(model, links, SCREW * L + b), S), links, RATE * L + b)
            for k in range(link["freedoms"]):
                f = link["freedom"] + k
                # dexp^-1_{-psi} (V + w) to first order
                out[d, f] = moves[at + f_all + f, 0] + 0.5 * links[RATE * L + b, k]
                out[d, f_all + f] = work.acceleration[f, 0]
        out[d, 2 * f_all] = error
        for r in range(rows.shape[1]):
            out[d, 2 * f_all + 1 + r] = 0.0 if is_off(model, work, r) else rows[SLIP, r]
    return OK if is_regular else NOT_REGULAR
