# SPDX-License-Identifier: Apache-2.0
"""What the processes of all tests have in common."""

import os
import signal

from volume import some  # imports no NumPy

# One thread for BLAS, before any test loads NumPy: more make small solves slower.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# A shell starts a process in the background with SIGINT ignored, and so would be the Ctrl-C of the tests.
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(config, items):
    """Of tests with the marker `volume(n)` keep n cases, others on every day; all with VERIFY=1."""
    cases = {}
    for item in items:
        marker = item.get_closest_marker("volume")
        if marker is not None:
            cases.setdefault((item.nodeid.partition("[")[0], *marker.args), []).append(item)
    kept = {item for (_, count), found in cases.items() for item in some(found, count)}
    left = [item for found in cases.values() for item in found if item not in kept]
    if left and not any("[" in argument for argument in config.args):  # a case that is named runs
        items[:] = [item for item in items if item not in left]
        config.hook.pytest_deselected(items=left)
