# SPDX-License-Identifier: Apache-2.0
"""Page with one line for each robot, and the table by format of docs/reference/robots.md."""

PAGE = """# Tested robots

Written by `python benchmarks/robots.py --motion --page FILE` from all files of the packages example-robot-data,
mujoco and dm_control.

{formats}

{summary}

* *time to load*: on a shared machine of two cores, without building the model.
* *merged*: links without a body of their own: fixed to another link or to the world, or massless at the
  end of a chain.
* *left out*: elements of the file that the scene lacks. **Bold**: they change the motion.
* *accelerations*: largest difference of the accelerations of all bodies at {states} random states, relative
  to the largest acceleration. URDF: Pinocchio reads the same file. SDF: Pinocchio with the model of the
  scene, loops as exact rows. MJCF: MuJoCo reads the same file, without armature, friction, limits, contact
  and actuators.
* *motion*: largest difference of the positions of all bodies, in m, after 1 s of motion under gravity from
  random speeds, without stops and friction. Here an accuracy of 1e-10. MJCF: MuJoCo's RK4 with steps of
  0.05 ms. URDF: RK4 of Pinocchio's accelerations on its configuration space with steps of 0.1 ms. If the
  ends differ by more than 1e-8 m, their steps are divided by four or five, up to twice. After that, SciPy's
  Radau integrates their accelerations.
"""
FORMATS = {
    "urdf": "URDF of example-robot-data",
    "sdf": "SDF of example-robot-data",
    "xml": "MJCF of mujoco and dm_control",
}
TREES, MUJOCO = "Pinocchio", "MuJoCo"
CHAOTIC = 1e-6  # m; a motion is chaotic if a disturbance of 1e-12 has a larger effect
HEAD = (
    "file",
    "bodies",
    "degrees of freedom",
    "loops",
    "couplings",
    "merged",
    "left out",
    "time to load, s",
    "accelerations",
    "motion",
)


def page_of(rows, states):
    """Text of a page with one line for each file."""
    loaded = [row for row in rows if "refused" not in row]
    summary = "\n".join(f"* {line}" for line in summary_of(rows))
    lines = [
        PAGE.format(states=states, formats=by_format(rows), summary=summary),
        f"| {' | '.join(HEAD)} |",
        "|---" * len(HEAD) + "|",
    ]
    for row in loaded:
        out = ", ".join(
            f"**{count} {what}**" if changes else f"{count} {what}" for what, count, changes in row["left_out"]
        )
        cells = [row[key] for key in ("robot", "bodies", "freedoms", "loops", "couplings", "merged")]
        cells += [out or "-", f"{row['load_s']:.2f}"]
        cells += [_short(row.get("difference")), _short(row.get("motion_m"))]
        lines.append(f"| {' | '.join(map(str, cells))} |")
    lines += ["", "## Refused", ""]
    lines += ["Many files of the packages are no robots: arenas, parts that others include, tests.", ""]
    lines += ["| file | reason |", "|---|---|"]
    lines += [
        f"| {row['robot']} | {row['refused'].replace('|', '/').replace('<', '`<').replace('>', '>`')} |"
        for row in rows
        if "refused" in row
    ]
    return "\n".join([*lines, ""])


def by_format(rows):
    """Table with one line for each format: files that load, and the largest differences from other software."""
    lines = ["| files | load | difference of accelerations | of positions after 1 s |", "|---|---|---|---|"]
    for suffix, name in FORMATS.items():
        mine = [row for row in rows if row["format"] == suffix]
        robots = [row for row in mine if not _is_no_robot(row.get("refused", ""))]
        loaded = [row for row in robots if "refused" not in row]
        found = [row["difference"] for row in loaded if isinstance(row.get("difference"), float)]
        moved = [row["motion_m"] for row in loaded if _is_compared(row)]
        cells = (
            f"at most {max(each):.0e}{unit}, {len(each)} robots" if each else "-"
            for each, unit in ((found, ""), (moved, " m"))
        )
        lines.append(f"| {name} | {len(loaded)} of {len(robots)} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _is_no_robot(refused):
    """True for a file without moving parts, or one that MuJoCo's compiler refuses."""
    return "no link that moves" in refused or ": mjcf: " in refused


def _is_compared(row):
    """True if the motion was compared, and is not chaotic."""
    motion = row.get("motion_m", float("inf"))
    finite = isinstance(motion, float) and motion < float("inf")
    return finite and row.get("grown_m", 0.0) <= CHAOTIC


def summary_of(rows):
    """Lines with the numbers of robots that load and were compared, and the largest differences."""
    loaded = [row for row in rows if "refused" not in row]
    still = sum("no link that moves" in row.get("refused", "") for row in rows)
    theirs = sum(": mjcf: " in row.get("refused", "") for row in rows)
    left = len(rows) - still - theirs
    lines = [
        f"{len(loaded)} of {len(rows)} files load. Of the others {still} have no part that moves, and "
        f"MuJoCo's compiler refuses {theirs}. {len(loaded)} of the {left} that are left load: "
        f"{len(loaded) / max(left, 1):.0%}."
    ]
    for peer in dict.fromkeys(row["peer"] for row in loaded if "peer" in row):
        compared = [row for row in loaded if row.get("peer") == peer]
        compared = [row for row in compared if isinstance(row["difference"], float)]
        found = sorted(((row["difference"], row) for row in compared), key=lambda each: each[0])
        if not found:
            continue
        worst, row = found[-1]
        lines.append(
            f"Accelerations of {len(found)} robots differ from {peer} by at most {worst:.1g} "
            f"({_name(row)}), half of them by less than "
            f"{found[len(found) // 2][0]:.0e}."
        )
        for _, row in found:
            if "errors" in row:
                ours, theirs = row["errors"]
                lines.append(
                    f"{_name(row)} at its worst state, against 50 digits: the "
                    f"largest error is {ours:.1g} here and {theirs:.1g} in {peer}."
                )
    for peer in (TREES, MUJOCO):
        rows_of = [row for row in loaded if row.get("peer") == peer and "motion_m" in row]
        stopped = [row for row in rows_of if isinstance(row["motion_m"], str)]
        stopped += [row for row in rows_of if row["motion_m"] == float("inf")]
        chaotic = [row for row in rows_of if row.get("grown_m", 0.0) > CHAOTIC]
        moved = [row for row in rows_of if row not in stopped and row not in chaotic]
        if not moved:
            continue
        worst = max(moved, key=lambda row: row["motion_m"])
        lines.append(
            f"1 s of motion of {len(moved)} robots differs from {peer} by at most "
            f"{worst['motion_m']:.1g} m ({_name(worst)}); positions change by up to "
            f"{max(row['moved_m'] for row in moved):.1f} m."
        )
        lines += [
            f"The motion of {_name(row)} is chaotic: it differs by {row['motion_m']:.1g} m, and by "
            f"{row['grown_m']:.1g} m here if the twists at the start are larger by 1e-12."
            for row in chaotic
        ]
        stiff = [_name(row) for row in moved if row.get("stiff")]
        if stiff:
            lines.append(
                "Damping stops light joints of some robots so soon that explicit steps would have to be "
                f"tiny. There the other side is SciPy's Radau: {', '.join(stiff)}."
            )
        if stopped:
            lines.append(
                f"The motion of {', '.join(map(_name, stopped))} is not compared: steps here are below "
                "0.01 ms, or those of SciPy's Radau are too many."
            )
    without = [row for row in loaded if "difference" not in row]
    if without:
        names = ", ".join(map(_name, without))
        lines.append(f"Not compared: {names} (loops or welds, which MuJoCo keeps only softly).")
    return lines


def _name(row):
    """File name of a row."""
    return row["robot"].rpartition("/")[2]


def _short(value):
    return f"{value:.1g}" if isinstance(value, float) else "-"
