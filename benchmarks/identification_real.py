# SPDX-License-Identifier: Apache-2.0
"""Public recordings of real pendulums: how far ahead published, identified and mujoco.sysid's numbers predict.

    python benchmarks/identification_real.py geared TRAJECTORY... LAST
    python benchmarks/identification_real.py simple data_measured.csv
    python benchmarks/identification_real.py free SinglePendulumDataForParameterEstimation.mat
    python benchmarks/identification_real.py chaotic DoublePendulumDataForParameterEstimation.mat

geared  : double pendulum with two geared motors, 500 Hz, measured currents; the last file is held out.
          https://github.com/dfki-ric-underactuated-lab/double_pendulum: data/experiment_records/design_C.1/sys_id/
          20230629/*/trajectory.csv
simple  : pendulum with a motor, 200 Hz, measured current; 6.6 to 9 s are held out.
          https://github.com/dfki-ric-underactuated-lab/torque_limited_simple_pendulum: results/
          control_method_energy_shaping/data_measured.csv
free    : pendulum without a motor, encoder, 100 of 1000 Hz; the first piece that its authors hold out.
chaotic : the same with two arms, 200 of 1000 Hz; pieces are held out after those that are fitted, as of large motions.
          https://github.com/dynamicslab/MultiArm-Pendulum: ParameterEstimation/*Pendulum

All numbers are judged on what is held out, as by `compare`: rms of the worst output in the interval that ends next to
a time ahead. mujoco.sysid (pip install 'mujoco[sysid]') gets pieces of 1 s, with starts from the measurements around
them, and limits of a factor of five. Times are those of the process, all threads.
"""

import argparse
import time
from dataclasses import dataclass

import numpy as np
import scipy
from identification_double_pendulum import NAMES, scene
from identification_double_pendulum import log_of as double_log
from rich.console import Console
from rich.table import Table

from liegroup_core.identification import Given, Log, Measured, compare, identify
from liegroup_core.identification.comparison import fitted
from liegroup_core.identification.horizon import horizons
from liegroup_core.identification.log import joined
from liegroup_core.linear.numbers import Numbers
from liegroup_core.scene.load import scene_from_text

HEAD = "name: pendulum\ngravity: [0, 0, -9.81]\n"
BODY = "- {name: %(link)s, mass: %(mass)r, inertia: [%(inertia)r, %(inertia)r, %(inertia)r], com: [0, 0, %(com)r], "
BODY += "position: [0, 0, %(z)r]}"
JOINT = "- {name: %(joint)s, type: revolute, parent: %(parent)s, child: %(link)s, child_frame: {axis: [0, 1, 0]}, "
JOINT += "parent_frame: {position: [0, 0, %(z)r], axis: [0, 1, 0]}, friction: {%(friction)s}}"
# Published: sp_parameters_energy.yaml, mass of a point and damping; EstimatedParameters_*.mat.
SIMPLE = [("hinge", "arm", 0.6755, -0.5, 1e-4, 0.0, "viscous: 0.35, coulomb: 0.01")]
FREE = [("hinge", "arm", 0.147584572, -0.147754901, 1.09118505e-4, 0.0, "viscous: 2.23940125e-4")]
CHAOTIC = [
    ("shoulder", "upper", 9.38439748e-2, -0.108565215, 4.37529430e-4, 0.0, "viscous: 2.37142783e-4"),
    ("elbow", "lower", 0.13759597, -0.116779018, 1.26882939e-3, -0.172719204, "viscous: 1.0e-5"),
]
FITTED, HELD_OUT = (0.0, 3.5), (6.6, 9.0)  # s, of the simple pendulum
PIECE, FACTOR, SECONDS = 1.0, 5.0, 2.5  # s, factor, s of each recording with motors
AHEAD, SERVES = (0.1, 0.3, 1.0), 0.01  # s and rad, of the table


@dataclass
class Case:
    """Scene with published numbers, names of those that vary, logs for both parts."""

    scene: object
    names: list
    log: Log
    held_out: Log


def chain(links):
    """Scene of [(joint, link, mass, com, inertia, z, friction)]."""
    keys, bodies, joints, parent = ("joint", "link", "mass", "com", "inertia", "z", "friction"), "", "", "world"
    for link in links:
        values = dict(zip(keys, link)) | {"parent": parent}
        bodies, joints, parent = f"{bodies}{BODY % values}\n", f"{joints}{JOINT % values}\n", link[1]
    return scene_from_text(f"{HEAD}bodies:\n{bodies}joints:\n{joints}")


def geared(paths):
    """Case of the double pendulum with motors."""
    logs = [double_log(path, SECONDS) for path in paths]
    return Case(scene(), NAMES, joined(logs[:-1]), logs[-1])


def simple(paths):
    """Case of the simple pendulum."""
    table, logs = np.genfromtxt(paths[0], delimiter=",", names=True), []
    for low, high in (FITTED, HELD_OUT):
        part = table[(table["time"] >= low) & (table["time"] < high)]
        at, later = part["time"] - part["time"][0], part["time"] - part["time"][0] > 0.2  # delays move starts
        given = (Given("hinge.effort", at, part["torque"], "linear"),)
        logs.append(_log(at[later], part["position"][later, None], ("hinge",), given, None))
    names = ["arm.mass", "bodies.arm.inertia.1", "hinge.friction.viscous", "hinge.friction.coulomb"]
    return Case(chain(SIMPLE), names, *logs)


def free(paths):
    """Case of the pendulum without a motor."""
    data = scipy.io.loadmat(paths[0], squeeze_me=True)
    fitted, held = ([_free(y[:1], 10, ("hinge",)) for y in data[key]] for key in ("Y_id", "Y_vad"))
    return Case(chain(FREE), ["bodies.arm.inertia.1", "hinge.friction.viscous"], joined(fitted), held[0])


def chaotic(paths):
    """Case of the double pendulum without motors."""
    logs = [_free(y[:2], 5, ("shoulder", "elbow")) for y in scipy.io.loadmat(paths[0], squeeze_me=True)["Y_id"][:5]]
    names = ["lower.mass", "bodies.upper.inertia.1", "bodies.lower.inertia.1"]
    names += [f"{joint}.friction.viscous" for joint in ("shoulder", "elbow")]
    return Case(chain(CHAOTIC), names, joined(logs[:4]), logs[4])


def _free(angles, every, joints):
    """Log of angles (n, k) at 1 kHz from the upright: of the links."""
    angles = angles[:, ::every].T - np.pi
    angles = np.column_stack([angles[:, 0], *np.diff(angles).T])
    return _log(1e-3 * every * np.arange(len(angles)), angles, joints, (), 0.0)


def _log(times, angles, joints, given, delay):
    channels, unknown = tuple(f"{joint}.position" for joint in joints), np.full(len(joints), np.nan)
    return Log(given, (Measured("/encoders", times, channels, angles, unknown, delay),))


def theirs(case):
    """Numbers of the case by mujoco.sysid, in the order of the names."""
    from mujoco import MjData, MjSpec, sysid
    from mujoco.sysid import ParameterDict  # missing without [sysid]

    spec = MjSpec.from_string(_mjcf(case.scene))
    spec.option.timestep = float(np.median(np.diff(case.log.measured[0].times)))
    model, parameters = spec.compile(), ParameterDict()
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
        '<mujoco><compiler angle="radian" balanceinertia="true"/><option integrator="RK4" gravity="0 0 -9.81">'
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


CASES = {"geared": geared, "simple": simple, "free": free, "chaotic": chaotic}


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("case", choices=CASES)
    parser.add_argument("files", nargs="+")
    args = parser.parse_args()
    case, console = CASES[args.case](args.files), Console(width=150)
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
    table = Table(
        "numbers", *numbers.paths, *(f"rms {ahead:g} s ahead" for ahead in AHEAD), f"within {SERVES:g} rad", "CPU, s"
    )
    for code, (values, spent) in found.items():
        fit, near, solution, _ = fitted(numbers.scene_at(values), case.held_out)
        judged, errors = horizons(fit, near, solution), []
        for ahead in AHEAD:
            worst = [each.error[np.argmin(np.abs(each.ahead - ahead))] for each in judged]
            errors.append(f"{max(worst):.2g} rad")
        serves = f"{min(each.within(SERVES) for each in judged):.2g} s"
        table.add_row(code, *(f"{v:.4g}" for v in values), *errors, serves, f"{spent:.0f}")
    console.print(table)
    console.print(f"identify: {compare(numbers.scene_at(found['identify'][0]), case.held_out).verdict}")


if __name__ == "__main__":
    main()
