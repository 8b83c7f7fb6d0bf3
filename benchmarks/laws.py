# SPDX-License-Identifier: Apache-2.0
"""What does a law cost: an operation of a formula, a step beside a servo, and an instant of a sampled law?"""

import sys
import time
from pathlib import Path

import numpy as np

from liegroup_core import Simulation
from liegroup_core.forces.formulas import Program, differentiate, evaluate, table_arrays
from liegroup_core.scene.load import scene_from_text

sys.path.insert(0, str(Path(__file__).parents[1] / "test"))
from scene_files import text_of

FORMULAS = ("x*K + y*K - z", "sin(x*K)", "sqrt(abs(x) + K)", "x/K", "clip(x*K, -1, 1)", "exp(K*x)", "x**2*K + y**3")
PENDULUM = scene_from_text(text_of("pendulum_laws.yaml"), "pendulum")
PD = {"type": "law", "name": "pd", "inputs": {"q": "hinge.position", "w": "hinge.velocity"}}
PD |= {"outputs": [{"joint": "hinge", "effort": "6*(0.5 - q) - 0.4*w"}]}
SERVO = {"type": "servo", "name": "pd", "joint": "hinge", "stiffness": 6, "damping": 0.4, "position": 0.5}


def fastest(call, repeats=30):
    """Shortest time of a call, s."""
    found = []
    for _ in range(repeats):
        began = time.perf_counter()
        call()
        found.append(time.perf_counter() - began)
    return min(found)


def operations(text):
    """(ns for the value, ns for value and derivative) of an operation of a formula, among several hundred."""
    program = Program()
    names = {name: program.new() for name in "xyz"}
    for k in range(200):
        program.compile(text.replace("K", str(1 + 1e-3 * k)), names)
    code, tables = np.array(program.code, dtype=np.int64).reshape(-1, 5), table_arrays(program.tables)
    registers = np.zeros((len(program.registers), 2))
    registers[:, 0] = program.registers
    for name, row in zip("xyz", ((0.3, 1.0), (-0.7, 0.5), (1.1, 0.2))):
        registers[names[name]] = row
    return [1e9 * fastest(lambda f=f: f(code, *tables, registers)) / len(code) for f in (evaluate, differentiate)]


def step(*forces, count=20_000, **settings):
    """us of a step of 1 ms of the pendulum."""
    simulation = Simulation(PENDULUM.remade(forces=list(forces)), step=1e-3, quiet=True, estimate=False, **settings)
    simulation.advance(100)
    return 1e6 * fastest(lambda: simulation.advance(count), 5) / count


def main():
    """Print the costs."""
    for text in FORMULAS:
        print("{:20s} value {:5.1f} ns, with derivative {:5.1f} ns".format(text, *operations(text)))
    for method in ("rkmk4", "generalized_alpha"):
        costs = {"no force": (), "servo": (SERVO,), "law": (PD,)}
        print(method, ", ".join(f"{name} {step(*forces, method=method):.2f} us" for name, forces in costs.items()))
    print(f"a step with an instant of a sampled law {step(PD | {'period': 1e-3}, count=2000, method='rkmk4'):.0f} us")


if __name__ == "__main__":
    main()
