# SPDX-License-Identifier: Apache-2.0
"""What a run should keep and how well it did: energy, momentum components, closed joints."""
import numpy as np

from liegroup_core.dynamics.symmetry import conserved_momentum, momentum_values

# Kinds of forces with an energy; with damping they take it, too.
KEEPING_ENERGY = ("spring_damper", "torsional_spring_damper", "linear_spring_damper")
# Joint residuals take 50 us each: of longer runs every second, third, ... sample is looked at.
MOST_RESIDUALS = 40_000


def energy(layout, motion):
    """Energy drift, J: the largest change within intervals in which nothing feeds or takes energy.

    returns (figures, [(times, change)] per interval); figures["drift_J"] is None where forces of
    the scene itself feed or take energy. The relative drift is in parts of the largest kinetic energy, which unlike the
    energy itself does not depend on where heights are counted from.
    """
    scene = layout.scene
    bodies = layout.body_names
    feeding = [force.name for force in scene.forces
               if force.type not in KEEPING_ENERGY or force.damping > 0.0]
    kinetic, curves, final = 0.0, [], None
    for stretch in motion.stretches:
        pose = _pose(stretch)
        total, potential, angles = [], [], None
        for p, v in zip(pose, stretch.twist):
            sample = layout.sample(p, v, near=angles)
            angles = sample.angles
            total.append(sample.energy)
            potential.append(layout.sample(p, np.zeros_like(v), near=angles).energy)
        total, potential = np.array(total), np.array(potential)
        kinetic = max(kinetic, float((total - potential).max()))
        if not feeding:
            for first, end in stretch.free(bodies):
                change = total[first:end] - total[first]
                curves.append((stretch.log_times[first:end], change))
                final = change[-1]
    worst = max((float(np.abs(change).max()) for _, change in curves), default=None)
    return {
        "drift_J": worst, "final_J": final, "largest_kinetic_J": kinetic,
        "relative_drift": worst / kinetic if worst is not None and kinetic > 0.0 else None,
        "intervals": len(curves), "seconds": _seconds(curves),
        "left_out": "forces feed or take energy: " + ", ".join(feeding) if feeding else
                    _pushed_text(motion, bodies)}, curves


def momentum(scene, motion):
    """Drift of each kept momentum component over the intervals without a wrench on its bodies.

    returns (list of figures, one per component; [(times, change)] of each)
    """
    figures, curves = [], []
    for kept in conserved_momentum(scene):
        parts = [[] for _ in kept.labels]
        largest = np.zeros(len(kept.labels))
        for stretch in motion.stretches:
            values = momentum_values(scene, kept, stretch.rotation, stretch.position,
                                     stretch.twist)
            largest = np.maximum(largest, np.abs(values).max(axis=0))
            for first, end in stretch.free(kept.bodies):
                for part, value in zip(parts, values[first:end].T):
                    part.append((stretch.log_times[first:end], value - value[0]))
        for label, unit, part, value in zip(kept.labels, kept.units, parts, largest):
            figures.append({
                "component": label, "bodies": list(kept.bodies), "unit": unit,
                "drift": max((float(np.abs(change).max()) for _, change in part), default=None),
                "largest": float(value), "intervals": len(part), "seconds": _seconds(part),
                "left_out": _pushed_text(motion, kept.bodies)})
            curves.append(part)
    return figures, curves


def joints(layout, motion):
    """Largest position residual of each joint; one in m and rad is the norm of both.

    returns ({joint: {"largest", "unit", "at_s"}}, samples looked at, [(times, residual of the
    worst joint)] per stretch)
    """
    names = [joint.name for joint in layout.scene.joints]
    turning = {owner for owner, rows in zip(layout.owners, layout.row_names)
               if any(row.startswith("w") for row in rows)}
    units = ["m, rad" if j in turning else "m" for j in range(len(names))]
    if not names:
        return {}, 0, []
    every = max(1, -(-sum(len(s.steps) for s in motion.stretches) * len(names) // MOST_RESIDUALS))
    parts = []
    for stretch in motion.stretches:
        residuals = [layout.sample(*state).joint_residuals
                     for state in zip(_pose(stretch)[::every], stretch.twist[::every])]
        parts.append((stretch.log_times[::every],
                      np.array([[found[name] for name in names] for found in residuals])))
    times, rows = (np.concatenate(part) for part in zip(*parts))
    figures = {name: {"largest": float(rows[:, j].max()), "unit": units[j],
                      "at_s": float(times[rows[:, j].argmax()])} for j, name in enumerate(names)}
    return figures, len(rows), [(time, row.max(axis=1)) for time, row in parts]


def _pose(stretch):
    """(k, n, 12) as the core has it."""
    k, n = stretch.position.shape[:2]
    return np.concatenate([stretch.rotation.reshape(k, n, 9), stretch.position], axis=2)


def _seconds(curves):
    return float(sum(times[-1] - times[0] for times, _ in curves))


def _pushed_text(motion, bodies):
    """What of the run does not count because of wrenches, or None."""
    seconds = 0.0
    for stretch in motion.stretches:
        free = sum(stretch.times[end - 1] - stretch.times[first]
                   for first, end in stretch.free(bodies))
        seconds += stretch.times[-1] - stretch.times[0] - free
    return f"{seconds:.4g} s with an applied wrench" if seconds > 0.0 else None
