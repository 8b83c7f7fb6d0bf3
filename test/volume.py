# SPDX-License-Identifier: Apache-2.0
"""How much of tests that gain by volume is run: all of it by `make verify`, a part by `make test`.

The part changes from day to day, so that all of it is run in time. Every case passes `make verify`.
"""

import datetime
import os

VERIFY = os.environ.get("VERIFY") == "1"


def some(cases, count):
    """All cases with VERIFY=1, else so many of them: others on every day."""
    cases = list(cases)
    if VERIFY or len(cases) <= count:
        return cases
    first = count * datetime.date.today().toordinal()
    return [cases[(first + k) % len(cases)] for k in range(count)]
