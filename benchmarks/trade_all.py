# SPDX-License-Identifier: Apache-2.0
"""Measure the trade of every example scene for docs/which_method.json, and print its tables.

    python benchmarks/trade_all.py
    python benchmarks/trade_all.py --write          only print the tables from the JSON

Cached measurements of the same scene, version and processor are reused, so an interrupted call
resumes. To measure again, remove the folder `trades` in the cache folder (~/.cache/liegroup_core,
or LIEGROUP_CACHE_DIR). For each scene and accuracy, a simulation to that accuracy is compared with a
reference integration at times other than those of the trade. Scenes that the reference does not support,
with stops, friction or cables, are omitted.
"""

import argparse
import json
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from side_by_side import trade_page

from liegroup_core import Simulation, SimulationError, load_scene
from liegroup_core.mechanism.body_model import initial_state
from liegroup_core.reference import Reference, Trajectory, distance
from liegroup_core.study.trade.reference_solution import scaled
from liegroup_core.study.trade.trade import BUDGET, WANTED, Trade
from liegroup_sim_ros.report.trade_figures import document_part

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT / "docs" / "which_method.json"
INSTANTS = 1000  # largest number of times in the horizon at which a requested accuracy is checked


def measure(scene, methods, workers, budget):
    """(Trade, its part of the JSON document) of a scene."""
    trade = Trade(scene, tell=lambda text: print(f"  {text}", flush=True))
    count = 0
    for _ in trade.measure(methods, workers=workers, budget=budget):
        count += 1
    print(f"  {count} settings measured, {len(trade.cells)} known", flush=True)
    return trade, document_part(trade)


def promises(scene, trade):
    """[{accuracy, measured error, estimated error, until: s or None}] for WANTED."""
    found, runs = [], []
    for wanted in WANTED:
        simulation = Simulation(scene, accuracy=wanted, horizon=trade.horizon)
        total = round(trade.horizon / simulation.step)
        every = max(1, -(-total // INSTANTS))
        motion = []
        for _ in range(total // every):
            simulation.advance(every)
            sample = simulation.sample()
            motion.append((sample.time, sample.pose, sample.twist))
        until = simulation.accurate_until
        entry = {
            "accuracy": wanted,
            "estimate": simulation.largest_error,
            "until": until if np.isfinite(until) else None,
        }
        found.append(entry)
        runs.append((entry, motion))
    times = np.unique(np.concatenate([[row[0] for row in motion] for _, motion in runs]))
    pose, twist = initial_state(trade.layout.centred)
    true, apart = Reference(scene, pose, twist, end=times[-1]).at(times)
    known = scaled(apart.position, apart.angle, trade.truth.length)
    for entry, motion in runs:
        rows = np.searchsorted(times, [row[0] for row in motion])
        poses = np.array([row[1] for row in motion])
        k, n = poses.shape[:2]
        off = distance(
            Trajectory(
                times[rows], poses[..., :9].reshape(k, n, 3, 3), poses[..., 9:], np.array([row[2] for row in motion])
            ),
            Trajectory(*(part[rows] for part in true)),
        )
        entry |= {"measured": scaled(off.position, off.angle, trade.truth.length), "known": known, "instants": k}
    return found


def condensed(part):
    """The part with only the cells on its Pareto front or in its list of cheapest cells."""
    wanted = sorted({*part["front"], *(entry["cell"] for entry in part["cheapest"] if entry["cell"] is not None)})
    place = {k: i for i, k in enumerate(wanted)}
    stopped = sum(bool(cell["stopped"]) for cell in part["cells"])
    flagged = sum(bool(cell.get("flagged")) for cell in part["cells"])
    return part | {
        "settings": len(part["cells"]),
        "stopped": stopped,
        "flagged": flagged,
        "methods": trade_page.by_method(part),
        "cells": [part["cells"][k] for k in wanted],
        "front": [place[k] for k in part["front"]],
        "cheapest": [
            entry | {"cell": None if entry["cell"] is None else place[entry["cell"]]} for entry in part["cheapest"]
        ],
    }


def main():
    """Measure and print; with --write only print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--write", action="store_true", help="only print the tables from the JSON")
    parser.add_argument("--workers", type=int, help="processes (default: one for each core)")
    parser.add_argument("--methods", nargs="+", help="default: all applicable methods")
    parser.add_argument(
        "--budget", type=float, default=BUDGET, help="CPU seconds of a run at most (default: %(default)g)"
    )
    parser.add_argument("scenes", nargs="*", help="measure only these and keep the others")
    args = parser.parse_args()
    known = {part["scene"]: part for part in json.loads(DATA.read_text())["scenes"]} if DATA.exists() else {}
    names = args.scenes or sorted(path.stem for path in (ROOT / "config/scenes").glob("*.yaml"))
    for name in () if args.write else names:
        print(name, flush=True)
        scene = load_scene(name)
        try:
            trade, part = measure(scene, args.methods, args.workers, args.budget)
        except SimulationError as error:
            print(f"  omitted: {error}", flush=True)
            continue
        known[name] = condensed(part) | {"promises": promises(scene, trade)}
        parts = [known[key] for key in sorted(known)]
        DATA.write_text(json.dumps({"format": 1, "scenes": parts}, indent=1, allow_nan=False) + "\n")
    print(trade_page.text(json.loads(DATA.read_text())["scenes"]))


if __name__ == "__main__":
    sys.exit(main())
