# SPDX-License-Identifier: Apache-2.0
"""Cost of a step, compile time cold and warm, and memory that steps allocate.

    python benchmarks/step_cost.py [--repeat 15]

Prints medians with the fastest and slowest run. Nothing is asserted: figures depend on the machine
and its load. The compile times of all families take several minutes.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
import tracemalloc

from rich.console import Console
from rich.table import Table

from liegroup_core import load_scene
from liegroup_core.engine import Engine

STEPS = 20_000
# Simulations that together use all kernels.
FAMILIES = {
    "relative coordinates in space": ("heavy_top", "rkmk4"),
    "relative coordinates in a plane": ("four_bar", "rkmk4"),
    "generalized_alpha in relative coordinates in space": ("heavy_top", "generalized_alpha"),
    "generalized_alpha in relative coordinates in a plane": ("four_bar", "generalized_alpha"),
    "constrained_rattle in relative coordinates in space": ("heavy_top", "constrained_rattle"),
    "constrained_rattle in relative coordinates in a plane": ("four_bar", "constrained_rattle"),
    "rotation methods": ("lagrangian_top", "rattle"),
}
START = """
import sys, time
start = time.process_time()
from liegroup_core import load_scene
from liegroup_core.engine import Engine
for name in sys.argv[1:]:
    scene, method = name.split()
    Engine(load_scene(scene), method=method)
print(time.process_time() - start)
"""


def microseconds_per_step(scene, group, repeat):
    """Times of one step, us: one value per run of STEPS steps from the initial state."""
    simulation = Engine(load_scene(scene), method="rkmk4", step=1e-4, group=group)
    times = []
    for _ in range(repeat):
        simulation.reset()
        start = time.perf_counter()
        simulation.advance(STEPS)
        times.append((time.perf_counter() - start) / STEPS * 1e6)
    return times


def start_up_seconds(cache, *names):
    """CPU time in s from `import` to ready simulations, in a new process with a cache folder."""
    run = subprocess.run(
        [sys.executable, "-c", START, *(" ".join(FAMILIES[name]) for name in names)],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "LIEGROUP_CACHE_DIR": cache},
    )
    return float(run.stdout)


def start_up(*names):
    """(CPU s of a first start, CPU s of a later start, median of 5)."""
    with tempfile.TemporaryDirectory() as cache:
        return (start_up_seconds(cache, *names), statistics.median(start_up_seconds(cache, *names) for _ in range(5)))


def bytes_allocated(steps):
    """Growth of traced Python and NumPy memory over `steps` steps in one call, bytes."""
    simulation = Engine(load_scene("heavy_top"), step=1e-4)
    simulation.advance(10)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    simulation.advance(steps)
    after = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    return after - before


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=15)
    options = parser.parse_args()
    table = Table(title="RKMK4, us per step")
    for column in ("scene", "group", "median", "fastest", "slowest"):
        table.add_column(column, justify="left" if column in ("scene", "group") else "right")
    for scene in ("heavy_top", "free_body", "double_pendulum"):
        for group in ("se3", "so3xr3"):
            times = microseconds_per_step(scene, group, options.repeat)
            table.add_row(scene, group, f"{statistics.median(times):.3f}", f"{min(times):.3f}", f"{max(times):.3f}")
    console = Console()
    console.print(table)
    table = Table(title="Start, CPU s from import to a ready simulation")
    for column in ("kernels of", "the first", "later"):
        table.add_column(column, justify="left" if column == "kernels of" else "right")
    for title, names in ({name: (name,) for name in FAMILIES} | {"all": tuple(FAMILIES)}).items():
        cold, warm = start_up(*names)
        table.add_row(title, f"{cold:.1f}", f"{warm:.2f}")
    console.print(table)
    console.print(f"bytes allocated by 1000 steps {bytes_allocated(1000)}, by 100000 steps {bytes_allocated(100_000)}")


if __name__ == "__main__":
    main()
