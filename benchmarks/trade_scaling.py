# SPDX-License-Identifier: Apache-2.0
"""Speed-up by two workers: the same trade with one and two, with bit-identical errors.

    python benchmarks/trade_scaling.py

Wall time, so run it on an idle machine. Prints the efficiency of the measurement alone, and
including the start of the workers, which takes a few seconds once.
"""

import json
import os
import tempfile
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from timing import speed_kept

from liegroup_core import load_scene
from liegroup_core.study.trade.cache import Store
from liegroup_core.study.trade.trade import Trade

SCENE, HORIZON = "heavy_top", 5.0
STEPS = [1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5]
METHODS = ["rkmk2", "rkmk3", "rkmk4", "rkmk8", "generalized_alpha"]


def measured(workers):
    """(cells, wall time in s, wall time from the first result on in s) of a fixed list of runs."""
    with tempfile.TemporaryDirectory() as folder:
        trade = Trade(load_scene(SCENE), HORIZON, Store(load_scene(SCENE), folder))
        start, first = time.perf_counter(), None
        for _ in trade.measure(METHODS, steps=STEPS, workers=workers):
            first = first or time.perf_counter()
        end = time.perf_counter()
        return trade.cells, end - start, end - first


def main():
    """Measure and print."""
    measured(1)  # compiles the kernels
    one, two = measured(1), measured(2)
    same = [
        json.dumps({key: value for key, value in cell.items() if key not in ("cost_us", "timings")}) for cell in one[0]
    ] == [
        json.dumps({key: value for key, value in cell.items() if key not in ("cost_us", "timings")}) for cell in two[0]
    ]
    print(f"{len(one[0])} runs, {os.cpu_count()} cores; errors {'the same' if same else 'DIFFER'}")
    print("workers   wall s   without the start s   CPU s of the runs")
    for workers, (cells, wall, rest) in ((1, one), (2, two)):
        cpu = sum(cell["cost_us"] * 1e-6 * HORIZON * cell["timings"] for cell in cells)
        print(f"{workers:7d} {wall:8.1f} {rest:21.1f} {cpu:19.1f}")
    print(f"efficiency of two: {one[1] / two[1] / 2:.2f}, without the start {one[2] / two[2] / 2:.2f}")
    print(f"two processes that share nothing keep {speed_kept():.2f} of their speed here")


if __name__ == "__main__":
    main()
