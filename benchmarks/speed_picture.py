# SPDX-License-Identifier: Apache-2.0
"""Picture of the cost of an accuracy, docs/speed.png: CPU time against error, this package and peers.

    python benchmarks/speed_picture.py [DATA [FILE]]    needs matplotlib

DATA is what `python benchmarks/peers.py --json DATA` writes; docs/peers.json is the run behind
docs/explanation/speed.md. Each point is the cheapest setting of a code for an error.
"""

import json
import sys

from matplotlib.figure import Figure

TITLES = {
    "P1": "heavy top",
    "P2": "free body",
    "P3": "planar four-bar",
    "P4 N=10": "planar chain of 10",
    "P4 N=100": "planar chain of 100",
    "S1": "robot arm of 6 hinges",
    "S2": "chain of 10 in space",
    "S3": "chain of 100 in space",
    "S4": "spatial four-bar",
    "S5": "Stewart platform",
    "S6": "humanoid of 26 bodies",
    "S7": "Delta robot",
    "S8": "crane of all joints",
}
CODES = {
    "liegroup_core": ("this package", "tab:blue", "o"),
    "mujoco": ("MuJoCo", "tab:orange", "s"),
    "pinocchio": ("Pinocchio with RK4", "tab:green", "^"),
    "exudyn": ("Exudyn", "tab:red", "D"),
}


def cheapest(entries, code):
    """([CPU ms per simulated s], [error]) of the cheapest settings of a code that meet an error."""
    costs = {}
    for entry in entries:
        if entry["code"] == code and entry["counted"]:
            for error, found in entry["to_target"].items():
                if found is not None:
                    costs[error] = min(1e3 * found["cost"], costs.get(error, float("inf")))
    return list(costs.values()), [float(error) for error in costs]


def main(data="docs/peers.json", path="docs/speed.png"):
    """Write the picture."""
    with open(data, encoding="utf-8") as file:
        problems = json.load(file)["problems"]
    figure = Figure(figsize=(12.0, 7.2), layout="constrained")
    cells = figure.subplots(3, 5).ravel()
    for axes, (name, title) in zip(cells, TITLES.items()):
        for code, (label, colour, mark) in CODES.items():
            costs, errors = cheapest(problems[name]["entries"], code)
            axes.loglog(costs, errors, marker=mark, markersize=4, color=colour, label=label)
        axes.set_title(title, fontsize=10)
        axes.set_yticks((1e-3, 1e-6, 1e-9))
        axes.tick_params(labelsize=8)
        axes.grid(alpha=0.3)
    for axes in cells[len(TITLES) :]:
        axes.axis("off")
    handles, labels = cells[0].get_legend_handles_labels()
    cells[len(TITLES)].legend(handles, labels, loc="center", fontsize=10, frameon=False)
    figure.supxlabel("CPU ms per simulated second", fontsize=10)
    figure.supylabel("error of the attitude, and of the joints", fontsize=10)
    figure.savefig(path, dpi=90)


if __name__ == "__main__":
    main(*sys.argv[1:])
