# SPDX-License-Identifier: Apache-2.0
"""How well a scene predicts a machine, std_msgs/Float64MultiArray: a row for each measured output, see matrices.py.

Columns: standard deviation of the noise; rms errors of predictions some time ahead; the same by the largest error that
serves or is explained; time in s for which predictions serve. NaN: not known yet, or not judged.
"""

import numpy as np

from . import matrices

TYPE = matrices.TYPE
AHEAD = (0.1, 0.3, 1.0, 3.0)  # s
ERRORS, RATIOS = (tuple(f"{what}_{ahead:g}s" for ahead in AHEAD) for what in ("error", "ratio"))
COLUMNS = ("noise", *ERRORS, *RATIOS, "horizon_s")


def encode(horizons, ratios, tolerance):
    """Serialized message of [Horizon] and [(h,)] ratios.

    tolerance : error up to which predictions serve, units of the output
    """
    rows = []
    for each, ratio in zip(horizons, ratios):
        known = [np.flatnonzero(np.isclose(each.ahead, ahead))[:1].tolist() for ahead in AHEAD]
        pairs = [(each.error[k[0]], ratio[k[0]]) if k else (np.nan, np.nan) for k in known]
        rows += [each.noise, *(pair[0] for pair in pairs), *(pair[1] for pair in pairs), each.within(tolerance)]
    return matrices.encoder([each.name for each in horizons], COLUMNS)(rows)


def decode(payload):
    """{output: {column: number}}. Raises MessageError."""
    names, columns, values = matrices.decode(payload, COLUMNS)
    rows = np.reshape(values, (len(names), len(columns))).tolist()
    return {name: dict(zip(columns, row)) for name, row in zip(names, rows)}
