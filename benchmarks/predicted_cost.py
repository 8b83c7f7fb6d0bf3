# SPDX-License-Identifier: Apache-2.0
"""Predicted and measured cost of a stage, in relative coordinates and on SE(3)^n.

    python benchmarks/predicted_cost.py

CPU ns of a stage of rkmk4, the fastest of several runs, and what formulations/relative/cost.py
predicts, for the example scenes that both can hold, mechanisms of side_by_side/ and random ones. The
last column is what group `auto` loses where its choice is not the smaller cost.
"""

import sys
import time
from pathlib import Path

from rich.console import Console
from rich.table import Table
from side_by_side import ours, robots, spatial

from liegroup_core import load_scene
from liegroup_core.engine import Engine
from liegroup_core.formulations.relative.cost import absolute_cost, is_cheaper, relative_cost

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "test"))
import random_mechanisms  # noqa: E402

STAGES = 4  # of rkmk4
STEP = 1e-6  # s: the pose hardly changes
PROBLEMS = {
    "S1": spatial.arm,
    "S2": lambda: spatial.chain_in_space(10),
    "S4": spatial.four_bar_in_space,
    "S5": spatial.stewart,
    "S6": robots.humanoid,
    "S7": robots.delta,
    "four-bars in space, 4": lambda: spatial.ladder(4),
    "four-bars in space, 30": lambda: spatial.ladder(30),
}
RANDOM = {"tree": 8, "loops": 16, "spherical loops": 4, "planar loops": 8}


def scenes():
    """{name: Scene}."""
    found = {p.stem: load_scene(p.stem) for p in sorted((ROOT / "config/scenes").glob("*.yaml"))}
    found |= {name: ours.scene_of(make()) for name, make in PROBLEMS.items()}
    for kind, count in RANDOM.items():
        for seed in range(count):
            found[f"{kind} {seed}"] = random_mechanisms.random_mechanism(kind, seed)[0]
    return found


def nanoseconds(scene, group, steps=200, repeat=20):
    """(CPU ns of a stage, Engine)."""
    engine = Engine(scene, "rkmk4", STEP, group=group, quiet=True)
    engine.advance(5)
    fastest = float("inf")
    for _ in range(repeat):
        start = time.process_time()
        engine.advance(steps)
        fastest = min(fastest, time.process_time() - start)
    return 1e9 * fastest / steps / STAGES, engine


def main():
    """Measure and print."""
    console = Console(width=110)
    table = Table(title="ns of a stage: measured, predicted")
    table.add_column("mechanism")
    for column in ("relative", "predicted", "SE(3)^n", "predicted", "auto loses"):
        table.add_column(column, justify="right")
    worst = 1.0
    for name, scene in scenes().items():
        here, engine = nanoseconds(scene, "relative")
        predicted = relative_cost(engine.layout.relative)
        if engine.layout.needs_relative:
            continue
        chosen_relative = is_cheaper(engine.layout.relative)
        there, engine = nanoseconds(scene, "se3")
        predicted_there = absolute_cost(engine.layout.model)
        chosen = here if chosen_relative else there
        loss = chosen / min(here, there)
        worst = max(worst, loss)
        table.add_row(
            name,
            f"{here:.0f}",
            f"{predicted:.0f}",
            f"{there:.0f}",
            f"{predicted_there:.0f}",
            f"{100 * (loss - 1):.0f} %" if loss > 1.0 else "",
        )
    console.print(table)
    console.print(f"largest loss {100 * (worst - 1):.0f} %")


if __name__ == "__main__":
    main()
