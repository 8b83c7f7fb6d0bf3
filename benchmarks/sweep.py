# SPDX-License-Identifier: Apache-2.0
"""Cost of sweeps: overhead of a run and of a task, worker start, one worker compared with two.

    python benchmarks/sweep.py [--runs N]

Rates are in wall time and need an idle machine. CPU times, summed over all processes, are also valid on
a busy one. docs/how-to/sweep.md uses these numbers.
"""

import argparse
import os
import resource
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from timing import speed_kept

from liegroup_core import load_scene
from liegroup_core.study.sweep.sweep import Sweep, simulate
from liegroup_core.study.tasks import run

# Varying gravity does not violate any joint.
SCENES = "free_body", "heavy_top", "double_pendulum", "four_bar"
VARY, STEPS = "gravity.0=0:1", 1000
TASKS = 1000


def nothing(item):
    """Empty task."""
    return item


def costs(name):
    """(CPU s of a run with almost no steps, CPU s of a run of STEPS steps), medians of 20."""
    medians = []
    for steps in (1, STEPS):
        sweep = Sweep.of(load_scene(name), [VARY], 20, steps, settings={"step": 1e-3})
        simulate((sweep, 0, sweep.values[:2]))
        medians.append(float(np.median(simulate((sweep, 0, sweep.values))["cpu_s"])))
    return medians


def cpu():
    """CPU s of this process and its finished child processes."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def tasks(count):
    """(wall s, CPU s) of `count` empty tasks on two workers, including their start and end."""
    wall, used = time.perf_counter(), cpu()
    for _ in run(nothing, range(count), workers=2):
        pass
    return np.array([time.perf_counter() - wall, cpu() - used])


def sweeping(runs, workers):
    """(wall s, wall s from the second result on, runs in that time, CPU s of the runs, CPU s of
    all, result) of a sweep.
    """
    sweep = Sweep.of(load_scene("heavy_top"), [VARY], runs, STEPS, settings={"step": 1e-3})
    start, used, first, pieces = time.perf_counter(), cpu(), None, []
    for columns in sweep.run(range(runs), workers=workers):
        pieces.append(columns)
        # Excludes the first piece, computed in this process, and the second, which waits for workers.
        if len(pieces) == 2:
            first = time.perf_counter()
    end, count = time.perf_counter(), runs - sum(len(piece["run"]) for piece in pieces[:2])
    pieces.sort(key=lambda piece: piece["run"][0])
    return (
        end - start,
        end - first,
        count,
        sum(piece["cpu_s"].sum() for piece in pieces),
        cpu() - used,
        np.concatenate([piece["top.x"] for piece in pieces]),
    )


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=4000, help="default: %(default)s")
    runs = parser.parse_args().runs
    if runs < 1000:
        parser.error("--runs must be at least 1000: rates are measured from the third piece on")
    print(f"CPU time of a run of {STEPS} steps, rkmk4, with 10 checks of energy and joints")
    for name in SCENES:
        least, all_ = costs(name)
        print(f"  {name:16s} {all_ * 1e3:7.2f} ms, of which {least * 1e3:6.2f} ms without the steps")
    few = tasks(2)
    task = (tasks(TASKS) - few) / (TASKS - 2)
    print(
        f"two workers start and end in {few[0]:.1f} s, {few[1]:.1f} s of CPU time; a task takes "
        f"{task[0] * 1e3:.2f} ms, {task[1] * 1e3:.2f} ms of CPU time, more than its work"
    )
    found = {workers: sweeping(runs, workers) for workers in (1, 2)}
    same = np.array_equal(found[1][-1], found[2][-1])
    print(f"{runs} runs of heavy_top, {os.cpu_count()} cores; {'the same bits' if same else 'DIFFER'}")
    print("workers   wall s   runs/s   runs/s without the start   CPU s of runs   of all")
    for workers, (wall, rest, count, own, used, _) in found.items():
        print(f"{workers:7d} {wall:8.1f} {runs / wall:8.0f} {count / rest:26.0f} {own:15.1f} {used:8.1f}")
    rates = {workers: entry[2] / entry[1] for workers, entry in found.items()}
    print(f"efficiency of two: {found[1][0] / found[2][0] / 2:.2f}, without the start {rates[2] / rates[1] / 2:.2f}")
    print(f"two processes that share nothing keep {speed_kept():.2f} of their speed here")


if __name__ == "__main__":
    main()
