# SPDX-License-Identifier: Apache-2.0
"""Time of a simulation step, and the slowdown of two concurrent processes."""

import statistics
import subprocess
import sys
import time

STEPPING = """
import time
from liegroup_core import load_scene
from liegroup_core.engine import Engine
simulation = Engine(load_scene("heavy_top"), step=1e-4)
print(flush=True)
input()
start = time.perf_counter()
simulation.advance(2_000_000)
print(time.perf_counter() - start)
"""


def seconds_of_step(simulation, steps, repeat):
    """CPU time of one step, s: the fastest of several runs from the initial state."""
    times = []
    for _ in range(repeat):
        simulation.reset()
        start = time.process_time()
        simulation.advance(steps)
        times.append(time.process_time() - start)
    return min(times) / steps


def speed_kept(rounds=3):
    """Relative speed of a process while an independent process runs at the same time.

    Cores share clock and memory, and virtual cores more: this bounds the speed of two workers.
    """

    def seconds(count):
        processes = [
            subprocess.Popen([sys.executable, "-c", STEPPING], text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
            for _ in range(count)
        ]
        for process in processes:
            process.stdout.readline()  # it is ready
        for process in processes:
            process.stdin.write("\n")
            process.stdin.flush()
        return statistics.mean(float(process.communicate()[0]) for process in processes)

    return statistics.median(seconds(1) / seconds(2) for _ in range(rounds))
