# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim replay --resimulate`: run a recording again and compare, sample by sample.

From the recorded start, wrenches and resets. With the recorded method and step on the same kind of
machine with the same versions every bit must be the same; elsewhere, or with other settings, the
difference is the result, and may be held against a bound. No ROS is needed.
"""

from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.numbers import shown
from liegroup_sim_ros.recording.attachments import machine, versions
from liegroup_sim_ros.recording.check import check_settings
from liegroup_sim_ros.recording.motion import Motion

from .repeat import Repeat, ReplayError, make_simulation

# What may change the bits, as far as a recording says it: older ones say less.
_VERSIONS = ("liegroup_sim_ros", "numpy", "scipy", "numba", "llvmlite")
_MACHINE = ("processor", "libc", "target", "features")


def resimulate(recording, tell=lambda text: None, **other):
    """Figures of a Recording run again; other : settings in place of the recorded ones.

    tell : function that is told what is done now
    returns what Repeat.figures has, and "experiment": {setting: [recorded, now]}, "platform":
    {what: [recorded, here]} of what is not the same here, "must_be_equal": neither has an entry
    raises RecordingError, SceneError, ReplayError
    """
    scene = scene_from_text(recording.scene_text, source=f"{recording.path}: scene.yaml")
    check_settings(recording, scene)
    settings = recording.settings
    try:
        simulation = make_simulation(scene, settings, **other)
    except (ValueError, TypeError) as error:
        raise ReplayError(f"{recording.path}: cannot be simulated again: {error}") from None
    motion = Motion(recording)
    repeat = Repeat(recording, simulation)
    for block in motion.blocks():
        repeat.add(block)
        tell(f"{motion.samples} of {motion.expected} samples")
    experiment = {
        key: [settings.get(key), value]
        for key, value in other.items()
        if settings.get(key) != value
    }
    elsewhere = _elsewhere(settings)
    return {
        "log": str(recording.path),
        **repeat.figures(),
        "resets": len(motion.stretches) - 1,
        "missing_samples": motion.missing,
        "not_finite_samples": motion.not_finite,
        "experiment": experiment,
        "platform": elsewhere,
        "must_be_equal": not (experiment or elsewhere),
    }


def _elsewhere(settings):
    """{what: [recorded, here]} of what may change the bits."""
    found = {}
    for key, names, here in (("versions", _VERSIONS, versions()), ("machine", _MACHINE, machine())):
        recorded = settings.get(key)
        recorded = recorded if isinstance(recorded, dict) else {}
        found |= {
            name: [recorded[name], here.get(name)]
            for name in names
            if name in recorded and recorded[name] != here.get(name)
        }
    return found


def told(figures, bound=None):
    """(lines for the user, None or what is wrong in one line)."""
    log, samples, identical = (figures[key] for key in ("log", "samples", "identical"))
    lines = [
        f"{key}: {now!r} in place of {before!r}"
        for key, (before, now) in figures["experiment"].items()
    ]
    lines += [
        f"{key} here: {now}, recorded with {before}"
        for key, (before, now) in figures["platform"].items()
    ]
    apart = figures["largest_difference"]
    if identical == samples:
        lines.append(f"{log}: the same bit for bit in {samples} samples")
    else:
        at = figures["first_difference"]
        lines.append(
            f"{log}: {identical} of {samples} samples are the same bit for bit"
            + (f"; {at['body']} differs from {shown(at['at_s'], 's')} on" if at else "")
        )
        lines.append(
            "largest difference: "
            + ", ".join(
                shown(apart[key], unit)
                for key, unit in (
                    ("position_m", "m"),
                    ("angle_rad", "rad"),
                    ("angular_rad_s", "rad/s"),
                    ("linear_m_s", "m/s"),
                )
            )
        )
    if figures["not_finite_samples"]:
        return lines, f"{log}: {figures['not_finite_samples']} samples are not finite"
    if figures["stopped"]:
        return lines, f"{log}: simulated again it {figures['stopped']}"
    if bound is not None:
        worst = max((apart["position_m"], apart["angle_rad"]), key=lambda x: (x != x, x))
        if not worst <= bound:
            return lines, (
                f"{log}: the difference of {shown(worst)} m or rad is more than {bound:g}"
            )
    elif figures["must_be_equal"] and identical < samples:
        return lines, f"{log}: simulated again it is not the same"
    return lines, None
