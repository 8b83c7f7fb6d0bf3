# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim replay --resimulate`: repeat a recorded run and compare all samples.

The run is repeated from the recorded initial state, wrenches and resets. With the recorded settings
and versions, on the same kind of machine, all samples must be bit-identical. Otherwise the
difference is the result; it can be compared with a bound. No ROS is needed.
"""

from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.numbers import counted, shown
from liegroup_sim_ros.recording.attachments import machine, versions
from liegroup_sim_ros.recording.check import check_settings
from liegroup_sim_ros.recording.motion import RecordedMotion

from .repeat import Repeat
from .rerun import ReplayError, make_simulation

# Entries that may affect the bits of the result; older recordings lack some of them.
_VERSIONS = ("liegroup_sim_ros", "numpy", "scipy", "numba", "llvmlite")
_MACHINE = ("processor", "libc", "target", "features")
LONGEST = 40  # characters of a quoted value; the list of processor features is much longer


def resimulate(recording, progress=lambda text: None, **other):
    """Figures of a repeated Recording; other : settings that replace recorded ones.

    progress : function of one line of text
    returns the entries of Repeat.figures, "experiment": {setting: [recorded, now]}, "platform":
    {entry: [recorded, here]} of differing versions and machine properties, "must_be_equal":
    whether both are empty
    raises RecordingError, SceneError, ReplayError
    """
    scene = scene_from_text(recording.scene_text, source=f"{recording.path}: scene.yaml")
    check_settings(recording, scene)
    settings = recording.settings
    try:
        simulation = make_simulation(scene, settings, **other)
    except (ValueError, TypeError) as error:
        raise ReplayError(f"{recording.path}: cannot be simulated again: {error}") from None
    motion = RecordedMotion(recording)
    repeat = Repeat(recording, simulation)
    for block in motion.blocks():
        repeat.add(block)
        progress(f"{motion.samples} of {counted(motion.expected, 'sample')}")
    experiment = {key: [settings.get(key), value] for key, value in other.items() if settings.get(key) != value}
    platform = platform_changes(settings)
    return {
        "log": str(recording.path),
        **repeat.figures(),
        "resets": len(motion.stretches) - 1,
        "missing_samples": motion.missing,
        "not_finite_samples": motion.not_finite,
        "experiment": experiment,
        "platform": platform,
        "must_be_equal": not (experiment or platform),
    }


def platform_changes(settings):
    """{entry: [recorded, present]} of versions and machine properties that differ."""
    changes = {}
    for key, names, present in (("versions", _VERSIONS, versions()), ("machine", _MACHINE, machine())):
        recorded = settings.get(key)
        recorded = recorded if isinstance(recorded, dict) else {}
        changes |= {
            name: [recorded[name], present.get(name)]
            for name in names
            if name in recorded and recorded[name] != present.get(name)
        }
    return changes


def difference_cause(platform):
    """Text why a repeated run with the recorded settings differs; platform : result of platform_changes."""
    if not platform:
        return (
            "versions and machine are those of the recording: the file or the source code was "
            "changed, or messages are missing"
        )
    changes = ", ".join(
        f"{key} {now} instead of {before}"
        if max(len(str(before)), len(str(now))) <= LONGEST
        else f"{key} of the processor"
        for key, (before, now) in platform.items()
    )
    return f"versions or machine differ from the recording: {changes}"


def report(figures, bound=None):
    """(lines for the user, the failure in one line or None)."""
    log, samples, identical = (figures[key] for key in ("log", "samples", "identical"))
    lines = [f"{key}: {now!r} instead of {before!r}" for key, (before, now) in figures["experiment"].items()]
    lines += [f"{key}: {now} here, {before} in the recording" for key, (before, now) in figures["platform"].items()]
    apart = figures["largest_difference"]
    at = figures["first_difference"]
    lines.append(
        f"{log}: bit-identical in {identical} of {counted(samples, 'sample')}"
        + (f"; {at['body']} differs from t = {shown(at['at_s'], 's')} on" if at else "")
    )
    if identical < samples:
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
        return (lines, f"{log}: NaN or infinity in {counted(figures['not_finite_samples'], 'sample')}")
    if figures["stopped"]:
        return lines, f"{log}: the repeated simulation {figures['stopped']}"
    if bound is not None:
        worst = max((apart["position_m"], apart["angle_rad"]), key=lambda x: (x != x, x))
        if not worst <= bound:
            return lines, (f"{log}: the difference of {shown(worst)} m or rad exceeds the bound {bound:g}")
    elif figures["must_be_equal"] and identical < samples:
        return lines, (f"{log}: re-simulation is not bit-identical; {difference_cause(figures['platform'])}")
    return lines, None
