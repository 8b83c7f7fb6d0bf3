# SPDX-License-Identifier: Apache-2.0
"""A real double pendulum: numbers from its recordings, beside the published ones.

    git clone https://github.com/dfki-ric-underactuated-lab/double_pendulum
    python benchmarks/identification_double_pendulum.py FILE...

where FILE is 20230629-143339/trajectory.csv, or others, of data/experiment_records/design_C.1/sys_id/20230629.

Recordings and published numbers (design C.1, model 1.0) are those of the repository: positions of two motors at 500 Hz
and the efforts that they report. Velocities are differences of the positions, and are left out. Both clocks are one, so
that the delay that is found is that of the measured current. Centres of mass and rotors are as published.
"""

import argparse

import numpy as np
from rich.console import Console
from rich.table import Table

from liegroup_core.identification import Given, Log, Measured, compare, identify
from liegroup_core.identification.log import joined
from liegroup_core.scene.load import scene_from_text

# Inertias about the joints, kg m^2.
LENGTH, MASS, CENTRE, INERTIA = 0.2, (0.52346, 0.62557), (0.2, 0.25569), (0.031887, 0.050870)
ROTOR, GEAR, VISCOUS, COULOMB = 6.287e-5, 6, (0.001, 0.001), (0.16, 0.12)
NAMES = [f"{link}.mass" for link in ("upper", "lower")]
NAMES += [f"bodies.{link}.inertia.1" for link in ("upper", "lower")]
NAMES += [f"{joint}.friction.{law}" for joint in ("shoulder", "elbow") for law in ("viscous", "coulomb")]
SCENE = """
name: double_pendulum
gravity: [0, 0, -9.81]
bodies:
  - {name: upper, mass: %(m0)r, inertia: [%(i0)r, %(i0)r, %(i0)r], com: [0, 0, %(c0)r], position: [0, 0, 0]}
  - {name: lower, mass: %(m1)r, inertia: [%(i1)r, %(i1)r, %(i1)r], com: [0, 0, %(c1)r], position: [0, 0, %(z)r]}
joints:
  - {name: shoulder, type: revolute, parent: world, child: upper, parent_frame: {axis: [0, 1, 0]},
     child_frame: {axis: [0, 1, 0]}, rotor: {inertia: %(rotor)r, ratio: %(gear)r},
     friction: {viscous: %(v0)r, coulomb: %(f0)r}}
  - {name: elbow, type: revolute, parent: upper, child: lower, parent_frame: {position: [0, 0, %(z)r], axis: [0, 1, 0]},
     child_frame: {axis: [0, 1, 0]}, rotor: {inertia: %(rotor)r, ratio: -%(gear)r},
     friction: {viscous: %(v1)r, coulomb: %(f1)r}}
"""


def scene():
    """Scene with the published numbers; the rotor of the elbow turns against it."""
    values = {"z": -LENGTH, "rotor": ROTOR, "gear": GEAR}
    for k in range(2):
        values |= {f"m{k}": MASS[k], f"c{k}": -CENTRE[k], f"v{k}": VISCOUS[k], f"f{k}": COULOMB[k]}
        values[f"i{k}"] = INERTIA[k] - MASS[k] * CENTRE[k] ** 2
    return scene_from_text(SCENE % values)


def log_of(path, seconds):
    """Log of the first seconds of a recording."""
    table = np.genfromtxt(path, delimiter=",", names=True)
    table = table[np.concatenate([[True], np.diff(table["time"]) > 0.0])]
    table = table[table["time"] < seconds]
    joints = ("shoulder", "elbow")
    given = [
        Given(f"{joint}.effort", table["time"], table[f"tau_meas{k}"], "linear") for k, joint in enumerate(joints, 1)
    ]
    later = table[table["time"] > 0.2]  # delays move starts to earlier times
    positions = np.column_stack([later["pos_meas1"], later["pos_meas2"]])
    channels = tuple(f"{joint}.position" for joint in joints)
    return Log(tuple(given), (Measured("/motors", later["time"], channels, positions, np.full(2, np.nan)),))


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("files", nargs="+", metavar="CSV")
    parser.add_argument("--seconds", type=float, default=4.0, help="of each recording (default: 4)")
    args = parser.parse_args()
    log, console = joined([log_of(path, args.seconds) for path in args.files]), Console()
    console.print(f"published numbers: {compare(scene(), log).verdict}")
    found = identify(scene(), log, NAMES)
    table = Table("number", "published", "found", "95 %")
    for name, before, value, half in zip(found.paths, found.before, found.values, 1.96 * found.deviations):
        table.add_row(name, f"{before:.4g}", f"{value:.4g}", f"{half:.2g}")
    console.print(table)
    fit = found.comparison
    rms = ", ".join(f"{each.name} {each.rms:.2g} rad" for each in fit.channels)
    console.print(f"found numbers: {fit.verdict} Rms: {rms}, in {len(fit.solution.point.bounds)} segments.")


if __name__ == "__main__":
    main()
