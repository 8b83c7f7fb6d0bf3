# SPDX-License-Identifier: Apache-2.0
"""How much of tests that gain by volume, or take long, is run: all by `make verify`, a part by `make test`.

The part changes from day to day, so that all of it is run in time. Every case passes `make verify`.
"""

import datetime
import os
import zlib

VERIFY = os.environ.get("VERIFY") == "1"


def some(cases, count):
    """All cases with VERIFY=1, else so many of them: others on every day."""
    cases = list(cases)
    if VERIFY or len(cases) <= count:
        return cases
    first = count * datetime.date.today().toordinal()
    return [cases[(first + k) % len(cases)] for k in range(count)]


def has_turn(name, days):
    """Whether it is the day of a test, on which it runs once in so many days; always with VERIFY=1."""
    return VERIFY or (zlib.crc32(name.encode()) + datetime.date.today().toordinal()) % days == 0
