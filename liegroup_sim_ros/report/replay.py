# SPDX-License-Identifier: Apache-2.0
"""The run once more from its own initial state and wrenches: independently, and bit for bit."""
import numpy as np

from liegroup_core import Simulation, SimulationError
from liegroup_core.reference import Trajectory, WrenchChange, distance, integrate

from ..messages import PoseStampedCodec, TwistStampedCodec
from ..recording import RecordingError

# (name in Distance, unit)
QUANTITIES = (("position", "m"), ("attitude", "1"), ("angle", "rad"), ("angular", "rad/s"),
              ("linear", "m/s"))


def reference_error(scene, recording, motion):
    """Distance of the recorded motion from an independent tight integration.

    returns (figures, [(times, position error, angle error, uncertainty of the two)] per stretch)

    The integration knows nothing of the engine (liegroup_core.reference) and starts at the
    recorded initial state, as every stretch did. Its uncertainty is its distance to a looser run.
    """
    pose, twist = initial_state(recording)
    errors, curves = [], []
    for stretch in motion.stretches:
        changes = [WrenchChange(step * stretch.step, body, wrench)
                   for step, body, wrench in stretch.changes]
        exact, uncertainty = integrate(scene, pose, twist, stretch.times, changes)
        error = distance(Trajectory(stretch.times, stretch.rotation, stretch.position,
                                    stretch.twist), exact)
        errors.append((error, uncertainty))
        curves.append((stretch.log_times, error.position.max(axis=1), error.angle.max(axis=1),
                       uncertainty.position.max(axis=1), uncertainty.angle.max(axis=1)))
    figures = {}
    for name, unit in QUANTITIES:
        parts = [(getattr(error, name), getattr(known, name)) for error, known in errors]
        figures[name] = {
            "unit": unit, "max": max(float(error.max()) for error, _ in parts),
            "final": float(parts[-1][0][-1].max()),
            "uncertainty": max(float(known.max()) for _, known in parts)}
    return figures, curves


def repeat(scene, recording, motion):
    """Simulate again with the recorded method, step, group and wrenches, and compare messages.

    returns figures: how many samples have the same bytes in every pose and twist message
    """
    settings = recording.settings
    simulation = Simulation(scene, settings["method"], settings["step"], settings["group"],
                            settings.get("stabilisation", "none"),
                            settings.get("baumgarte_time"), **settings.get("options", {}))
    pose, twist = initial_state(recording)
    pose_codec = PoseStampedCodec(settings["world_frame"])
    twist_codec = {body: TwistStampedCodec(body) for body in recording.bodies}
    same, different, stopped = 0, None, None
    for stretch in motion.stretches:
        simulation.set_state(pose, twist)
        waiting = list(stretch.changes)
        for k, steps in enumerate(stretch.steps.tolist()):
            try:
                while waiting and waiting[0][0] <= steps:
                    step, body, wrench = waiting.pop(0)
                    simulation.advance(step - simulation.steps)
                    simulation.apply_wrench(body, wrench)
                simulation.advance(steps - simulation.steps)
            except SimulationError as error:
                stopped = stopped or str(error)
                break
            sample = simulation.sample()
            stamp_ns = stretch.base_ns + simulation.time_ns
            wrong = [body for body in recording.bodies if
                     pose_codec.encode(stamp_ns, sample.positions[body].tolist(),
                                       sample.quaternions[body].tolist())
                     != recording.pose[body].payloads[stretch.rows[body][0][k]]
                     or twist_codec[body].encode(stamp_ns, sample.twists[body].tolist())
                     != recording.twist[body].payloads[stretch.rows[body][1][k]]]
            if wrong:
                different = different or {"at_s": float(stretch.log_times[k]), "body": wrong[0]}
            else:
                same += 1
    return {"samples": sum(len(s.steps) for s in motion.stretches), "identical": same,
            "first_difference": different, "stopped": stopped}


def initial_state(recording):
    """Pose (n, 12) and twist (n, 6) at the start. Raises RecordingError."""
    state, n = recording.initial_state, len(recording.bodies)
    try:
        pose = np.array(state["pose"], dtype=float).reshape(n, 12)
        twist = np.array(state["twist"], dtype=float).reshape(n, 6)
    except (KeyError, TypeError, ValueError):
        raise RecordingError(f"{recording.path}: its initial state is not 12 and 6 numbers for "
                             f"each of {n} bodies") from None
    return pose, twist
