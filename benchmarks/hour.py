# SPDX-License-Identifier: Apache-2.0
"""An hour of simulated time with the defaults, every scene: share of a core, estimate, energy, joints.

    python -P benchmarks/hour.py [--only SCENE ...] [--seconds 3600]

Prints, for the end of the run,
    share       CPU time of the thread per simulated second, %
    estimate    largest estimated error of a pose, relative to the mechanism's size or in rad
    wanted      error that the accuracy permits at this time
    accurate, predictable : last times at which the run reports so, s
    energy      at the start, and its change, J. It is conserved where nothing drives or damps the scene
    joints      largest residual of a joint at 360 samples, m or rad
    methods     share of the samples with `radau5`, %
andrews_squeezer is omitted: its motor accelerates it without limit.
"""

import argparse
import logging
import math
import time
from pathlib import Path

from rich.console import Console
from rich.table import Table

from liegroup_core import Simulation, load_scene

SCENES = Path(__file__).parents[1] / "config" / "scenes"
SAMPLES = 360
HEAD = ("scene", "share %", "estimate", "wanted", "accurate", "predictable", "energy", "change", "joints", "radau5 %")


def row(name, seconds):
    """Figures of a run to its end."""
    simulation = Simulation(load_scene(name), quiet=True)
    steps, cpu, stiff = round(seconds / simulation.step), 0.0, 0
    start, joints = simulation.energy(), 0.0
    for sample in range(1, SAMPLES + 1):
        began = time.thread_time()
        simulation.advance_to_step(steps * sample // SAMPLES)
        cpu += time.thread_time() - began
        joints = max(joints, simulation.sample().constraint_residual)
        stiff += simulation.method == "radau5"
    promise = simulation.promise
    return (
        name,
        f"{100.0 * cpu / seconds:.3f}",
        f"{simulation.largest_error:.1e}",
        f"{promise['accuracy'] * max(1.0, simulation.time / promise['horizon']):.1e}",
        *(
            "end" if until == math.inf else f"{until:.1f}"
            for until in (simulation.accurate_until, simulation.predictable_until)
        ),
        f"{start:.4g}",
        f"{simulation.energy() - start:.1e}",
        f"{joints:.0e}",
        f"{100.0 * stiff / SAMPLES:.0f}",
    )


def main():
    scenes = sorted({path.stem for path in SCENES.glob("*.yaml")} - {"andrews_squeezer"})
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", nargs="+", choices=scenes, default=scenes, metavar="SCENE")
    parser.add_argument("--seconds", type=float, default=3600.0)
    arguments = parser.parse_args()
    logging.disable(logging.CRITICAL)
    table = Table(*HEAD)
    for name in arguments.only:
        table.add_row(*row(name, arguments.seconds))
    Console(width=140).print(table)


if __name__ == "__main__":
    main()
