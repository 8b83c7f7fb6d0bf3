# SPDX-License-Identifier: Apache-2.0
"""Rotor inertias and dampings of MuJoCo's example arm from logs: `identify` beside mujoco.sysid on the same data.

    python benchmarks/identification_mujoco.py [--seconds 2] [--logs 5]

Needs pip install 'mujoco[sysid]'. The arm, its efforts and true values are those of the tests of mujoco.sysid: five
hinges, which start at rest, integrated with steps of 2 ms by `implicitfast`; RK4 is its most accurate integrator. The
logs come from `Simulation` to an accuracy of 1e-9, with noise of 5e-4 rad and 5e-3 rad/s at 500 Hz. Both know the
clock. mujoco.sysid gets the true start and weights by the noise; `identify` estimates both.

error : largest and rms error of a number, relative
z     : rms and largest of errors by the standard deviations that each states
"""

import argparse
import time

import numpy as np
from mujoco import MjData, MjSpec, sysid
from rich.console import Console
from rich.table import Table

from liegroup_core import Simulation
from liegroup_core.identification import Given, Log, Measured, identify
from liegroup_core.scene.load import load_scene

ARMATURE, DAMPING = np.array([0.5, 0.4, 0.3, 0.2, 0.1]), np.array([1.0, 0.8, 0.6, 0.4, 0.2])
MASS, LENGTH, HEIGHT = (1.0, 0.8, 0.6, 0.4, 0.2), (0.1, 0.1, 0.1, 0.08, 0.06), (0.05, 0.05, 0.05, 0.04, 0.03)
AXES = ("0 0 1", "0 1 0", "0 1 0", "0 0 1", "0 1 0")
SIZES, RATES, PHASES = (5.0, 4.0, 3.0, 2.0, 1.0), (0.5, 0.7, 0.4, 0.9, 0.6), (0.0, 0.5, 1.0, 1.5, 2.0)
RATE, NOISE = 500.0, np.repeat([5e-4, 5e-3], 5)  # Hz; rad and rad/s
GUESS = 1.5  # of the true values, at the start


def arm(armature, damping):
    """MJCF text of the arm."""
    bodies, ends = "", ""
    for k, (m, axis) in enumerate(zip(MASS, AXES)):
        z = LENGTH[k - 1] if k else 0.1
        bodies += (
            f'<body name="link{k}" pos="0 0 {z}"><inertial pos="0 0 {HEIGHT[k]}" mass="{m}" '
            f'diaginertia="{0.01 * m} {0.01 * m} {0.005 * m}"/><joint name="joint{k}" type="hinge" axis="{axis}" '
            f'armature="{armature[k]!r}" damping="{damping[k]!r}"/>'
        )
        ends += "</body>"
    motors = "".join(f'<motor name="act{k}" joint="joint{k}"/>' for k in range(5))
    sensors = "".join(f'<jointpos name="q{k}" joint="joint{k}"/>' for k in range(5))
    sensors += "".join(f'<jointvel name="v{k}" joint="joint{k}"/>' for k in range(5))
    return (
        f'<mujoco model="arm"><compiler angle="radian"/><option integrator="implicitfast" timestep="0.002">'
        f'<flag contact="disable"/></option><worldbody>{bodies}{ends}</worldbody>'
        f"<actuator>{motors}</actuator><sensor>{sensors}</sensor></mujoco>"
    )


def scene(folder, armature, damping):
    """Scene of the arm."""
    path = folder / "arm.xml"
    path.write_text(arm(armature.tolist(), damping.tolist()))
    return load_scene(path)


def recorded(true, seconds, seed):
    """(times, efforts (k, 5), measurements (k, 10)) of the true arm; efforts hold from one time to the next."""
    times = np.arange(int(seconds * RATE) + 1) / RATE
    efforts = np.array(SIZES) * np.sin(2.0 * np.pi * np.outer(times, RATES) + np.array(PHASES))
    simulation, rows = Simulation(true, accuracy=1e-9, step=1.0 / RATE, quiet=True), []
    for effort in efforts:
        found = simulation.sample().joint_coordinates
        rows.append(np.array([found[f"joint{k}"] for k in range(5)]).T.ravel())
        for k, value in enumerate(effort.tolist()):
            simulation.apply_effort(f"joint{k}", value)
        simulation.advance(1)
    return times, efforts, np.array(rows) + NOISE * np.random.default_rng(seed).standard_normal((len(times), 10))


def ours(first, times, efforts, values):
    """(values, standard deviations, s) of `identify`."""
    inputs = tuple(Given(f"joint{k}.effort", times, efforts[:, k]) for k in range(5))
    channels = tuple(f"joint{k}.{part}" for part in ("position", "velocity") for k in range(5))
    log = Log(inputs, (Measured("/joint_states", times[1:], channels, values[1:], np.full(10, np.nan), 0.0),))
    names = [f"joint{k}.rotor.inertia" for k in range(5)]
    names += [f"{each.name}.damping" for each in first.forces if getattr(each, "damping", None)][:5]
    began = time.perf_counter()
    found = identify(first, log, names)
    return found.values, found.deviations, time.perf_counter() - began


def theirs(text, times, efforts, values):
    """(values, standard deviations, s) of mujoco.sysid."""
    spec = MjSpec.from_string(text)
    model = spec.compile()
    data, parameters = MjData(model), sysid.ParameterDict()
    for key, true in (("armature", ARMATURE), ("damping", DAMPING)):
        for k, value in enumerate(true.tolist()):

            def change(spec, parameter, key=key, k=k):
                present = np.asarray(getattr(spec.joint(f"joint{k}"), key)).size
                number = float(parameter.value[0])
                setattr(spec.joint(f"joint{k}"), key, number if present == 1 else [number, 0.0, 0.0])

            name = f"{key}{k}"
            parameters.add(sysid.Parameter(name, GUESS * value, 0.1 * value, 3.0 * value, modifier=change))
    start = sysid.create_initial_state(model, data.qpos, data.qvel, data.act)
    # States, as sensors are those of the step before.
    names = [f"joint{k}_{part}" for part in ("qpos", "qvel") for k in range(5)]
    given, measured = sysid.TimeSeries(times, efforts), sysid.TimeSeries.from_names(times, values, model, names)
    sequences = sysid.ModelSequences("arm", spec, "log", start, given, measured)
    # It divides residuals by the norm of the measurements: with these weights, they are divided by the noise.
    weights = np.linalg.norm(values, axis=0) / np.sqrt(2.0) / NOISE
    residual = sysid.build_residual_fn(models_sequences=[sequences], sensor_weights=weights)
    began = time.perf_counter()
    found, result = sysid.optimize(initial_params=parameters, residual_fn=residual, verbose=False)
    spent = time.perf_counter() - began
    left, *_ = residual(found.as_vector(), found)
    _, half = sysid.calculate_intervals(left, result.jac)
    return found.as_vector(), np.ravel(half) / 1.96, spent


def main():
    from pathlib import Path
    from tempfile import TemporaryDirectory

    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--logs", type=int, default=5)
    args = parser.parse_args()
    truth, rows = np.concatenate([ARMATURE, DAMPING]), {}
    with TemporaryDirectory() as name:
        folder = Path(name)
        true = scene(folder, ARMATURE, DAMPING)
        first, text = scene(folder, GUESS * ARMATURE, GUESS * DAMPING), arm(ARMATURE.tolist(), DAMPING.tolist())
        for seed in range(args.logs):
            data = recorded(true, args.seconds, seed)
            rows.setdefault("identify", []).append(ours(first, *data))
            for name in ("implicitfast", "RK4"):
                found = theirs(text.replace("implicitfast", name), *data)
                rows.setdefault(f"mujoco.sysid, {name}", []).append(found)
    table = Table("code", "largest error", "rms error", "rms of z", "largest z", "time, s")
    for code, found in rows.items():
        error = np.array([values - truth for values, *_ in found])
        z = error / np.array([deviations for _, deviations, _ in found])
        table.add_row(
            code,
            f"{100.0 * np.abs(error / truth).max():.2f} %",
            f"{100.0 * np.sqrt(((error / truth) ** 2).mean()):.2f} %",
            f"{np.sqrt((z**2).mean()):.2f}",
            f"{np.abs(z).max():.1f}",
            f"{np.median([spent for *_, spent in found]):.1f}",
        )
    Console().print(table)


if __name__ == "__main__":
    main()
