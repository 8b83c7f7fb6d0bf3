# SPDX-License-Identifier: Apache-2.0
"""Public recordings of three real pendulums: how far ahead published, identified and mujoco.sysid's numbers predict.

    python benchmarks/identification_real.py double RECORDING... LAST
    python benchmarks/identification_real.py simple data_measured.csv
    python benchmarks/identification_real.py free SingleDataFreeSwing_1_Dt_0_0001.mat

double : data/experiment_records/design_C.1/sys_id/20230629/*/trajectory.csv of
         https://github.com/dfki-ric-underactuated-lab/double_pendulum: two geared motors, 500 Hz, measured currents;
         the last file is held out
simple : results/control_method_energy_shaping/data_measured.csv of
         https://github.com/dfki-ric-underactuated-lab/torque_limited_simple_pendulum: a motor, 200 Hz; the last 40 %
         is held out, as of the next one
free   : Datas/SinglePendulum of https://github.com/dynamicslab/MultiArm-Pendulum: free swing, 10 kHz, of which every
         fiftieth value counts

All numbers are judged by `compare` on what is held out. Needs pip install 'mujoco[sysid]' for mujoco.sysid, which gets
pieces of 1 s, with starts from the measurements around them, and the numbers as limits of a factor of five.
"""

import argparse
import time
from dataclasses import dataclass, replace

import numpy as np
import scipy
from identification_double_pendulum import NAMES, scene
from identification_double_pendulum import log_of as double_log
from rich.console import Console
from rich.table import Table

from liegroup_core.identification import Given, Log, Measured, compare, identify
from liegroup_core.identification.log import joined
from liegroup_core.linear.numbers import Numbers
from liegroup_core.scene.load import scene_from_text

PENDULUM = """
name: pendulum
gravity: [0, 0, -9.81]
bodies:
  - {name: arm, mass: %(mass)r, inertia: [%(inertia)r, %(inertia)r, %(inertia)r], com: [0, 0, %(com)r],
     position: [0, 0, 0]}
joints:
  - {name: hinge, type: revolute, parent: world, child: arm, parent_frame: {axis: [0, 1, 0]},
     child_frame: {axis: [0, 1, 0]}, friction: {viscous: %(viscous)r, coulomb: %(coulomb)r}}
"""
# Published: mass, length and damping of sp_parameters_energy.yaml, a point at the end; its friction is not given there.
SIMPLE = {"mass": 0.6755, "com": -0.5, "inertia": 1e-4, "viscous": 0.35, "coulomb": 1e-3}
# EstimatedParameters_SinglePendulum.mat: distance of the centre, mass, inertia, viscous friction.
FREE = {"mass": 0.147584572, "com": -0.147754901, "inertia": 1.09118505e-4, "viscous": 2.23940125e-4, "coulomb": 1e-6}
HELD_OUT, THINNED, PIECE, FACTOR = 0.4, 50, 1.0, 5.0
AHEAD = (0.1, 0.3, 1.0)  # s, of the table


@dataclass
class Case:
    """Recordings, scene with published numbers, names of those that vary, logs for both parts."""

    scene: object
    names: list
    log: Log
    held_out: Log


def double(paths):
    """Case of the double pendulum."""
    logs = [double_log(path, 4.0) for path in paths]
    return Case(scene(), NAMES, joined(logs[:-1]), logs[-1])


def simple(paths):
    """Case of the simple pendulum."""
    table = np.genfromtxt(paths[0], delimiter=",", names=True)
    log = _log(table["time"], table["position"], table["torque"])
    names = ["arm.mass", "bodies.arm.inertia.1", "hinge.friction.viscous", "hinge.friction.coulomb"]
    return Case(scene_from_text(PENDULUM % SIMPLE), names, *_parts(log))


def free(paths):
    """Case of the free pendulum, whose angle is 0 upright."""
    record = scipy.io.loadmat(paths[0], squeeze_me=True)["Theta1"][()]
    at, angle = (np.asarray(each, dtype=float)[::THINNED] for each in (record[0], record[1][()][0]))
    moving = np.flatnonzero(np.abs(np.diff(angle)) > 1e-3)[0] + 200  # 1 s after it was let go
    log = _log(at[moving:], angle[moving:] - np.pi)
    names = ["bodies.arm.inertia.1", "hinge.friction.viscous", "hinge.friction.coulomb"]
    return Case(scene_from_text(PENDULUM % FREE), names, *_parts(log))


def _log(at, angle, effort=None):
    given = () if effort is None else (Given("hinge.effort", at - at[0], effort, "linear"),)
    delay = 0.0 if effort is None else None
    return Log(given, (Measured("/m", at - at[0], ("hinge.position",), angle[:, None], np.array([np.nan]), delay),))


def _parts(log):
    """The first and the last part of a Log."""
    (measured,), end = log.measured, log.measured[0].times[-1]
    found = []
    for low, high in ((0.0, (1.0 - HELD_OUT) * end), ((1.0 - HELD_OUT) * end, np.inf)):
        begin = low + (0.2 if log.inputs else 0.0)  # delays move starts to earlier times
        rows = (measured.times >= begin) & (measured.times < high)
        one = replace(measured, times=measured.times[rows] - low, values=measured.values[rows])
        inputs = tuple(
            replace(each, times=each.times[keep] - low, values=each.values[keep])
            for each in log.inputs
            for keep in [(each.times >= low) & (each.times < high)]
        )
        found.append(Log(inputs, (one,)))
    return found


def theirs(case):
    """Numbers of the case by mujoco.sysid, in the order of the names."""
    from mujoco import MjData, MjSpec, sysid

    spec = MjSpec.from_string(_mjcf(case.scene))
    spec.option.timestep = float(np.median(np.diff(case.log.measured[0].times)))
    model, parameters = spec.compile(), sysid.ParameterDict()
    numbers = Numbers(case.scene, case.names)
    for path, value in zip(numbers.paths, numbers.values):

        def change(spec, parameter, path=path):
            _set(spec, path, float(parameter.value[0]))

        parameters.add(sysid.Parameter(path, value, value / FACTOR, value * FACTOR, modifier=change))
    joints = [joint.name for joint in case.scene.joints]
    sequences = []
    for k, (at, u, q, v) in enumerate(_pieces(case.log, joints)):
        data = MjData(model)
        data.qpos, data.qvel = q[0], v
        start = sysid.create_initial_state(model, data.qpos, data.qvel, data.act)
        names = [f"{joint}_qpos" for joint in joints]
        measured = sysid.TimeSeries.from_names(at, q, model, names)
        sequences.append(sysid.ModelSequences(f"m{k}", spec, f"p{k}", start, sysid.TimeSeries(at, u), measured))
    residual = sysid.build_residual_fn(models_sequences=sequences)
    found, _ = sysid.optimize(initial_params=parameters, residual_fn=residual, verbose=False)
    return found.as_vector()


def _pieces(log, joints):
    """Yield (times, efforts, positions, rates at the start) of pieces, at equal times."""
    (measured,) = log.measured
    step, angles = float(np.median(np.diff(measured.times))), measured.values
    for first, last in log.spans:
        for begin in np.arange(first + 5.0 * step, last - PIECE, PIECE):
            at = np.arange(0.0, PIECE, step)
            q = np.column_stack([np.interp(begin + at, measured.times, column) for column in angles.T])
            near = np.abs(measured.times - begin) < 5.5 * step
            v = np.array([np.polyfit(measured.times[near] - begin, column[near], 2)[1] for column in angles.T])
            given = {each.name: each for each in log.inputs}
            u = [
                np.interp(begin + at, given[name].times, given[name].values) if name in given else 0.0 * at
                for name in (f"{joint}.effort" for joint in joints)
            ]
            yield at, np.column_stack(u), q, v


def _mjcf(scene):
    """Chain of hinges about y; rotors are armatures."""
    bodies, before = "", 0.0
    for body, joint in zip(scene.bodies, scene.joints):
        z, rotor = float(body.position[2]), joint.rotor
        armature = 0.0 if rotor is None else float(rotor.inertia * rotor.ratio**2)
        inertia = " ".join(repr(float(body.inertia[k])) for k in range(3))
        bodies += (
            f'<body name="{body.name}" pos="0 0 {z - before}"><inertial pos="0 0 {float(body.com[2])}" '
            f'mass="{float(body.mass)}" diaginertia="{inertia}"/><joint name="{joint.name}" type="hinge" axis="0 1 0" '
            f'damping="{joint.friction.viscous}" frictionloss="{joint.friction.coulomb}" armature="{armature}"/>'
        )
        before = z
    motors = "".join(f'<motor joint="{joint.name}"/>' for joint in scene.joints)
    sensors = "".join(f'<jointpos name="{joint.name}" joint="{joint.name}"/>' for joint in scene.joints)
    return (
        '<mujoco><compiler angle="radian" balanceinertia="true"/><option integrator="implicitfast" gravity="0 0 -9.81">'
        f'<flag contact="disable"/></option><worldbody>{bodies}{"</body>" * len(scene.bodies)}</worldbody>'
        f"<actuator>{motors}</actuator><sensor>{sensors}</sensor></mujoco>"
    )


def _set(spec, path, value):
    """Set a number of the scene in a MjSpec."""
    _, owner, key, *rest = path.split(".")
    if key == "mass":
        spec.body(owner).mass = value
    elif key == "inertia":
        spec.body(owner).inertia = [value] * 3
    else:
        name = {"viscous": "damping", "coulomb": "frictionloss"}[rest[0]]
        present = np.asarray(getattr(spec.joint(owner), name)).size
        setattr(spec.joint(owner), name, value if present == 1 else [value] + [0.0] * (present - 1))


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("case", choices=("double", "simple", "free"))
    parser.add_argument("files", nargs="+")
    args = parser.parse_args()
    case, console = {"double": double, "simple": simple, "free": free}[args.case](args.files), Console(width=150)
    numbers, found = Numbers(case.scene, case.names), {}
    found["published"] = numbers.values, 0.0
    began = time.process_time()
    fit = identify(case.scene, case.log, case.names)
    found["identify"] = fit.values, time.process_time() - began
    try:
        began = time.process_time()
        found["mujoco.sysid"] = theirs(case), time.process_time() - began
    except ImportError:
        console.print("mujoco.sysid is not installed: pip install 'mujoco\\[sysid]'")
    table = Table("numbers", *numbers.paths, *(f"rms {ahead:g} s ahead" for ahead in AHEAD), "within noise", "CPU, s")
    verdicts = []
    for code, (values, spent) in found.items():
        one = compare(numbers.scene_at(values), case.held_out)
        errors = []
        for ahead in AHEAD:
            worst = [each.error[np.argmin(np.abs(each.ahead - ahead))] for each in one.horizons]
            errors.append(f"{max(worst):.2g} rad")
        table.add_row(code, *(f"{v:.4g}" for v in values), *errors, f"{one.horizon.within_noise:.2g} s", f"{spent:.0f}")
        verdicts.append(f"{code}: {one.verdict}")
    console.print(table)
    for verdict in verdicts:
        console.print(verdict)


if __name__ == "__main__":
    main()
