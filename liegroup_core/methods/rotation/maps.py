# SPDX-License-Identifier: Apache-2.0
"""One step of one rotating body for each method of the rotation family.

All in body axes: inertia I about the centre of mass, or about the fixed point of a held body;
angular velocity w; y = I w; torque T about that point. Q is the rotation of a step, R+ = R Q; z^ is
the matrix of the cross product. If y+ is exactly Q^T y plus the impulse of the torque, a step
changes the spatial angular momentum R y by that impulse only, for any Q.

KICKED, with T at both ends and p = y + (h/2) T:
    STOERMER_VERLET  w' = I^-1 exp(-(h/2) w) p ,  Q = exp(h w') ,  y+ = Q^T p + (h/2) T+
    LIE_NEWMARK      a = I^-1 (T - w x y) ,  Q = exp(h w + (h^2/2) a) ,
                     y+ + (h/2) w+ x y+ = y + (h/2) I a + (h/2) T+
    RATTLE           Q = exp f ,  Q Jd - Jd Q^T = h p^ ,  Jd = tr(I)/2 - I ;  y+ as in (6.42)
    AUSTIN           y_m + (h/2) w_m x y_m = p ,  Q = cay(h w_m) ;  y+ as in (6.42)
ITERATED, with a torque that depends on the result of the step:
    LIE_MIDPOINT     I w_m = exp(-(h/2) w_m) y + (h/2) T_m ,  Q = exp(h w_m)
    SIMO_WONG        Q = exp(Theta) ,  Theta = (h/2) (w + w+)
                     both: y+ = Q^T y + h exp(-(h/2) w_m) T_m or h exp(-Theta/2) T_m; T_m is the
                     torque at the midpoint, in the axes of the midpoint
    BOTTASSO_BORRI   Q = exp(Psi) ,  Psi = (h/2) (w + dexpinv_{-Psi} w+) ,
                     y+ = Q^T (y + (h/2) T) + (h/2) T+
"""

from liegroup_core.compiling import kernel, subroutine
from liegroup_core.lie.so3 import so3_exp
from liegroup_core.lie.vec3 import ZERO3, add3, axpy3, cross3, dot3, matmul3, matvec3, scale3, sub3, tmatvec3

from .newton import GYROSCOPIC, continuation, newton
from .newton import RATTLE as RATTLE_EQUATION

RUNGE_KUTTA, STOERMER_VERLET, LIE_NEWMARK, RATTLE, AUSTIN = 0, 1, 2, 3, 4
LIE_MIDPOINT, SIMO_WONG, BOTTASSO_BORRI = 5, 6, 7
FIRST_ITERATED = LIE_MIDPOINT

# Bound of an entry of R^T R - I: reached in about a thousand steps.
ORTHOGONALITY = 32 * 2.0**-53


@subroutine
def turn(x):
    """Rotation matrix exp(x), not inlined: each of its many calls would be compiled."""
    return so3_exp(x)


@kernel
def velocity(inertia, inverse, y):
    """Solve I w = y for w with unbiased round-off.

    Divides in principal axes, else computes I^-1 y with one refinement. Measured change of |I w| of a
    free body in 1e7 steps: with the rounded I^-1 alone 2e-10 to 6e-10; with division 1e-13, a
    random walk; with refinement 3e-11 to 6e-11, nearly proportional to the steps, because the
    round-off of w is correlated along a regular motion.
    """
    if inertia[1] == 0.0 and inertia[2] == 0.0 and inertia[5] == 0.0:
        return (y[0] / inertia[0], y[1] / inertia[4], y[2] / inertia[8])
    w = matvec3(inverse, y)
    return add3(w, matvec3(inverse, sub3(y, matvec3(inertia, w))))


@kernel
def renormalised(rot):
    """Project R to SO(3) if an entry of R^T R - I exceeds ORTHOGONALITY.

    `so3_nearest` does this in every step. Round-off then suppresses small corrections of
    large entries, but not those of small entries. This rotates R slightly, along a regular motion
    always in the same direction. Measured rotation of R against Y in 1e7 steps: 7e-12 rad if applied
    in every step, proportional to their number; 2e-13 rad with this bound, like a random walk.
    """
    x, y, z = (rot[0], rot[3], rot[6]), (rot[1], rot[4], rot[7]), (rot[2], rot[5], rot[8])
    xx, yy, zz = 1.0 - dot3(x, x), 1.0 - dot3(y, y), 1.0 - dot3(z, z)
    xy, xz, yz = dot3(x, y), dot3(x, z), dot3(y, z)
    if max(abs(xx), abs(yy), abs(zz), abs(xy), abs(xz), abs(yz)) <= ORTHOGONALITY:
        return rot
    return matmul3(
        rot,
        (
            1.0 + 0.5 * xx,
            -0.5 * xy,
            -0.5 * xz,
            -0.5 * xy,
            1.0 + 0.5 * yy,
            -0.5 * yz,
            -0.5 * xz,
            -0.5 * yz,
            1.0 + 0.5 * zz,
        ),
    )


@kernel
def cayley(x):
    """Cayley transform (1 - x^/2)^-1 (1 + x^/2): the rotation by 2 arctan(|x|/2) about x."""
    u, v, w = 0.5 * x[0], 0.5 * x[1], 0.5 * x[2]
    s = 2.0 / (1.0 + u * u + v * v + w * w)
    return (
        1.0 - s * (v * v + w * w),
        s * (u * v - w),
        s * (u * w + v),
        s * (u * v + w),
        1.0 - s * (u * u + w * w),
        s * (v * w - u),
        s * (u * w - v),
        s * (v * w + u),
        1.0 - s * (u * u + v * v),
    )


@kernel
def kicked_rotation(rule, inertia, inverse, h, w, torque):
    """First half of a KICKED step.

    returns (Q, h times the angular velocity w' of Q, momentum before the last half kick, converged)
    The momentum is y+ without (h/2) T+; for LIE_NEWMARK it is the right-hand side without (h/2) T+.
    """
    y = matvec3(inertia, w)
    p = axpy3(0.5 * h, torque, y)
    converged = True
    if rule == STOERMER_VERLET:
        x = scale3(h, matvec3(inverse, tmatvec3(turn(scale3(0.5 * h, w)), p)))
    elif rule == LIE_NEWMARK:
        a = matvec3(inverse, sub3(torque, cross3(w, y)))
        x = axpy3(h, w, scale3(0.5 * h * h, a))
    elif rule == RATTLE:
        x, converged = newton(
            RATTLE_EQUATION, inertia, h, scale3(h, matvec3(inverse, p)), ZERO3, ZERO3, ZERO3, scale3(h, p)
        )
    else:
        x, converged = newton(GYROSCOPIC, inertia, h, matvec3(inverse, p), ZERO3, ZERO3, ZERO3, p)
        x = scale3(h, x)
    Q = cayley(x) if rule == AUSTIN else turn(x)
    if rule == LIE_NEWMARK:
        return Q, x, axpy3(-0.5 * h, cross3(w, y), p), converged
    return Q, x, tmatvec3(Q, p), converged


@kernel
def kicked_end(rule, inertia, inverse, h, guess, q, torque):
    """End of a KICKED step; returns (w+, converged).

    q      : momentum before the last half kick, from `kicked_rotation`
    torque : T+
    guess  : initial guess of w+
    """
    y = axpy3(0.5 * h, torque, q)
    if rule != LIE_NEWMARK:
        return velocity(inertia, inverse, y), True
    return newton(GYROSCOPIC, inertia, h, guess, ZERO3, ZERO3, ZERO3, y)


@kernel
def iterated_step(rule, inertia, inverse, h, guess, w, first, torque):
    """Solve an ITERATED step with the torque of the last iteration.

    guess  : (h/2) w_m, Theta or Psi, rad
    first  : T at the start of the step, only for BOTTASSO_BORRI
    torque : T_m, or T+ of BOTTASSO_BORRI
    returns (solution for the quantity of `guess`, rad; converged)
    """
    y = matvec3(inertia, w)
    if rule == LIE_MIDPOINT:
        return continuation(inertia, h, guess, ZERO3, y, ZERO3, scale3(0.5 * h, torque))
    if rule == SIMO_WONG:
        return continuation(inertia, h, guess, ZERO3, y, scale3(h, torque), y)
    return continuation(inertia, h, guess, w, axpy3(0.5 * h, first, y), ZERO3, scale3(0.5 * h, torque))


@kernel
def iterated_end(rule, inertia, inverse, h, u, w, first, torque):
    """Rotations and velocities of an ITERATED step from the solution u of `iterated_step`.

    returns (rotation vector of the whole step, rotation vector to the pose at which the torque is
    evaluated, angular velocity there, w+)
    """
    y = matvec3(inertia, w)
    if rule == BOTTASSO_BORRI:
        momentum = axpy3(0.5 * h, torque, tmatvec3(turn(u), axpy3(0.5 * h, first, y)))
        end = velocity(inertia, inverse, momentum)
        return u, u, end, end
    half = u if rule == LIE_MIDPOINT else scale3(0.5, u)
    # The matrix that rotates R transports the momentum, so that R y is conserved.
    whole = scale3(2.0, half)
    momentum = add3(tmatvec3(turn(whole), y), scale3(h, tmatvec3(turn(half), torque)))
    end = velocity(inertia, inverse, momentum)
    if rule == LIE_MIDPOINT:
        return whole, half, scale3(2.0 / h, u), end
    return whole, half, scale3(0.5, add3(w, end)), end
