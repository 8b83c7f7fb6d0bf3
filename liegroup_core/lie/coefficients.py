# SPDX-License-Identifier: Apache-2.0
"""Scalar coefficients of exp, dexp and dexpinv on SO(3) and SE(3), as functions of the angle.

The argument is x = t^2 with t = |xi| in rad, so that the series need no square root. The closed
forms suffer from cancellation near t = 0. There, twelve terms of the power series in x are summed,
with a relative truncation error below 3e-18. Elsewhere exp uses the half angle, and dexpinv the
formula for the doubled angle. Neither suffers from cancellation.

t = 0, and x underflowed to 0, give the limit. Non-finite x (|xi| beyond 1e154) gives NaN. The
coefficients of dexpinv have poles at t = 2 pi k, k > 0; all others are smooth everywhere.
Up to t = 2 only + - * / are used: results are bit-identical on every machine.

Errors are relative, in units of 2^-53, compared with 50 digits on a dense grid that includes both
sides of each switch: test/core/test_lie_kernels.py.
"""
import math

from liegroup_core.compiling import kernel

EXP_SERIES_BELOW = 4.0      # x = t^2, rad^2: series below, half-angle form above
SHORT_SERIES_BELOW = 0.0625 # x = t^2, rad^2: six terms below
DEXPINV_SERIES_BELOW = 1.0  # x = t^2, rad^2: series below, halved angles above

# (-1)^k / (2k+1)!
SINC_SERIES = (
    1.0, -0.16666666666666666, 0.008333333333333333, -0.0001984126984126984,
    2.7557319223985893e-06, -2.505210838544172e-08, 1.6059043836821613e-10,
    -7.647163731819816e-13, 2.8114572543455206e-15, -8.22063524662433e-18,
    1.9572941063391263e-20, -3.868170170630684e-23)

# (-1)^k / (2k+2)!
VERSINC_SERIES = (
    0.5, -0.041666666666666664, 0.001388888888888889, -2.48015873015873e-05,
    2.755731922398589e-07, -2.08767569878681e-09, 1.1470745597729725e-11,
    -4.779477332387385e-14, 1.5619206968586225e-16, -4.110317623312165e-19,
    8.896791392450574e-22, -1.6117375710961184e-24)

# (-1)^k / (2k+3)!
CUBIC_SERIES = (
    0.16666666666666666, -0.008333333333333333, 0.0001984126984126984,
    -2.7557319223985893e-06, 2.505210838544172e-08, -1.6059043836821613e-10,
    7.647163731819816e-13, -2.8114572543455206e-15, 8.22063524662433e-18,
    -1.9572941063391263e-20, 3.868170170630684e-23, -6.446950284384474e-26)

# 2 (k+1) (-1)^(k+1) / (2k+4)!
VERSINC_SLOPE_SERIES = (
    -0.08333333333333333, 0.005555555555555556, -0.00014880952380952382,
    2.204585537918871e-06, -2.08767569878681e-08, 1.376489471727567e-10,
    -6.691268265342339e-13, 2.499073114973796e-15, -7.398571721961897e-18,
    1.7793582784901146e-20, -3.54582265641146e-23, 5.9510310317395135e-26)

# 2 (k+1) (-1)^(k+1) / (2k+5)!
CUBIC_SLOPE_SERIES = (
    -0.016666666666666666, 0.0007936507936507937, -1.6534391534391536e-05,
    2.0041686708353376e-07, -1.6059043836821615e-09, 9.17659647818378e-12,
    -3.936040156083729e-14, 1.3153016394598927e-16, -3.523129391410427e-19,
    7.736340341261368e-22, -1.4183290625645841e-24, 2.204085567310931e-27)

# |B_(2k+2)| / (2k+2)!, B the Bernoulli numbers
DEXPINV_SERIES = (
    0.08333333333333333, 0.001388888888888889, 3.306878306878307e-05,
    8.267195767195768e-07, 2.08767569878681e-08, 5.284190138687493e-10,
    1.3382536530684679e-11, 3.3896802963225827e-13, 8.586062056277845e-15,
    2.174868698558062e-16, 5.5090028283602295e-18, 1.3954464685812522e-19)

# 2 (k+1) |B_(2k+4)| / (2k+4)!
DEXPINV_SLOPE_SERIES = (
    0.002777777777777778, 0.00013227513227513228, 4.96031746031746e-06,
    1.670140559029448e-07, 5.2841901386874934e-09, 1.6059043836821613e-10,
    4.745552414851616e-12, 1.3737699290044552e-13, 3.914763657404511e-15,
    1.1018005656720459e-16, 3.069982230878755e-18, 8.483296895110721e-20)


@kernel
def sum_series(c, x):
    """Sum the polynomial c[0] + c[1] x + ... + c[11] x^11.

    Estrin's scheme groups it by powers of x^4. The groups are independent of each other: the sum
    takes two thirds of the time of Horner's scheme, with the same error.
    """
    x2 = x * x
    x4 = x2 * x2
    low = (c[0] + c[1] * x) + (c[2] + c[3] * x) * x2
    middle = (c[4] + c[5] * x) + (c[6] + c[7] * x) * x2
    high = (c[8] + c[9] * x) + (c[10] + c[11] * x) * x2
    return low + (middle + high * x4) * x4


@kernel
def exp_coefficients(x):
    """Coefficients of exp and dexp on SO(3).

    x : t^2, rad^2
    returns (sin t / t, (1 - cos t) / t^2, (t - sin t) / t^3)

    Error for t <= 3: 12, 5 and 4 units. Beyond t = 3 the first two have zeros, and their error is
    absolute: 8 + t/2 units of 1/t and of 1/t^2.
    """
    if x < EXP_SERIES_BELOW:
        return (sum_series(SINC_SERIES, x), sum_series(VERSINC_SERIES, x),
                sum_series(CUBIC_SERIES, x))
    if not x < math.inf:
        return math.nan, math.nan, math.nan
    # 1 - cos t = 2 sin^2(t/2) avoids cancellation.
    half = 0.5 * math.sqrt(x)
    a = math.sin(half) / half
    sinc = a * math.cos(half)
    return sinc, 0.5 * a * a, (1.0 - sinc) / x


@kernel
def _sum_short(c, x, x2, x4):
    """Sum the first six terms of a series in x."""
    return (c[0] + c[1] * x) + (c[2] + c[3] * x) * x2 + (c[4] + c[5] * x) * x4


@kernel
def turn_coefficients(x):
    """Coefficients of exp and dexp on SO(2): the first two of `exp_coefficients`.

    x : t^2, rad^2
    returns (sin t / t, (1 - cos t) / t^2)

    Six terms below t = 1/4, in half the time, with a relative truncation error below 1e-17.
    """
    if x < SHORT_SERIES_BELOW:
        x2 = x * x
        x4 = x2 * x2
        return _sum_short(SINC_SERIES, x, x2, x4), _sum_short(VERSINC_SERIES, x, x2, x4)
    sinc, versinc, _ = exp_coefficients(x)
    return sinc, versinc


@kernel
def dexp_slopes(x):
    """Derivatives of the two coefficients of dexp, for its lower left block on SE(3).

    x : t^2, rad^2
    returns (1/t d/dt (1 - cos t)/t^2, 1/t d/dt (t - sin t)/t^3)

    Error for t <= 3: 9 and 50 units. The second error is largest from t = 2 on, where the second
    value is a fifth of the first. Beyond t = 3: 16 + t/2 units of 1/t^3 and of 1/t^4.
    """
    if x < EXP_SERIES_BELOW:
        return sum_series(VERSINC_SLOPE_SERIES, x), sum_series(CUBIC_SLOPE_SERIES, x)
    sinc, versinc, cubic = exp_coefficients(x)
    return (sinc - 2.0 * versinc) / x, (versinc - 3.0 * cubic) / x


@kernel
def dexpinv_coefficients(x):
    """Coefficients of dexpinv on SO(3) and SE(3).

    x : t^2, rad^2
    returns (b, u), b = (1 - gamma)/t^2, u = (1/beta + gamma - 2)/t^4 = 1/t db/dt with
        gamma = (t/2) cot(t/2), beta = (sin(t/2)/(t/2))^2; NaN exactly at a pole

    Error for t <= pi: 4 and 10 units. Beyond pi: multiplied by pi/(2 pi - t), because the round-off
    of t^2 alone changes the values near the pole.
    Source: (6.12), (6.13) with gamma and h_X corrected; u is the whole factor of the last term.
    """
    if not x < math.inf:
        return math.nan, math.nan
    doublings = 0
    while x >= DEXPINV_SERIES_BELOW:
        x *= 0.25
        doublings += 1
    b = sum_series(DEXPINV_SERIES, x)
    u = sum_series(DEXPINV_SLOPE_SERIES, x)
    # gamma(2t) = gamma(t) - t^2 / (4 gamma(t)), written for b, and its derivative for u. Every term
    # is positive up to 2 pi: there is no cancellation except in gamma itself, at the pole.
    for _ in range(doublings):
        gamma = 1.0 - b * x
        if gamma == 0.0:
            return math.nan, math.nan
        f = 0.5 / gamma
        u = 0.0625 * (u + (2.0 * b + x * u) * f * f)
        b = 0.25 * (b + 0.5 * f)
        x *= 4.0
    return b, u


@kernel
def truncated_dexpinv_coefficients(highest, x):
    """Coefficients of the series of dexpinv, sum of (B_j / j!) ad^j, truncated at a power of ad.

    highest : last power j of the sum, 0 or more; terms beyond 7 are omitted
    x       : t^2, rad^2
    returns (first, b, u): factor of -ad, and b and u as `dexpinv_coefficients`

    An RK method of order p keeps its order with highest = p - 2 (test/contract/test_methods.py).
    Source: (6.40), its sum with (-ad)^j.
    """
    first, b, u = 0.0, 0.0, 0.0
    if highest >= 1:
        first = 0.5
    if highest >= 2:
        b = DEXPINV_SERIES[0]
    if highest >= 4:
        b += DEXPINV_SERIES[1] * x
        u = DEXPINV_SLOPE_SERIES[0]
    if highest >= 6:
        b += DEXPINV_SERIES[2] * x * x
        u += DEXPINV_SLOPE_SERIES[1] * x
    return first, b, u
