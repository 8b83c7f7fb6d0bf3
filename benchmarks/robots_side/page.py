# SPDX-License-Identifier: Apache-2.0
"""Page of the documentation with one line for each robot."""

PAGE = """# Robots that were tried

Written by `python benchmarks/robots.py --motion --page docs/reference/robots.md` from all files of the packages
example-robot-data, mujoco and dm_control. How to use your own: [bring your robot](../how-to/robot.md).

{summary}

* *time to load*: on a shared machine of two cores, without building the model.
* *merged*: links that are no body of their own: held by fixed joints to another link or to the world, or
  without mass at the end of a chain.
* *left out*: what the file has and the scene has not. **Bold**: it changes the motion.
* *accelerations*: largest difference of the accelerations of all bodies at {states} random states, relative
  to the largest acceleration. URDF: Pinocchio reads the same file. SDF: Pinocchio with the model of the
  scene, loops as exact rows. MJCF: MuJoCo reads the same file, without armature, friction, limits, contact
  and actuators.
* *motion*: largest difference of the positions of all bodies, in m, after 1 s of motion under gravity from
  random speeds. MuJoCo: RK4 with steps of 0.05 ms; here: rkmk8 with steps of 1 ms.
"""
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
        PAGE.format(states=states, summary=summary),
        f"| {' | '.join(HEAD)} |",
        "|---" * len(HEAD) + "|",
    ]
    for row in loaded:
        out = ", ".join(
            f"**{count} {what}**" if changes else f"{count} {what}"
            for what, count, changes in row["left_out"]
        )
        cells = [
            row[key] for key in ("robot", "bodies", "freedoms", "loops", "couplings", "merged")
        ]
        cells += [out or "-", f"{row['load_s']:.2f}"]
        cells += [_short(row.get("difference")), _short(row.get("motion_m"))]
        lines.append(f"| {' | '.join(map(str, cells))} |")
    lines += ["", "## Refused", ""]
    lines += [
        "Many files of the packages are no robots: arenas, parts that others include, tests.",
        "",
    ]
    lines += ["| file | reason |", "|---|---|"]
    lines += [
        f"| {row['robot']} | {row['refused'].replace('|', '/').replace('<', '`<').replace('>', '>`')} |"
        for row in rows
        if "refused" in row
    ]
    return "\n".join([*lines, ""])


def summary_of(rows):
    """Lines: how many robots load, were compared with what, and the largest differences."""
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
            f"({row['robot'].rpartition('/')[2]}), half of them by less than "
            f"{found[len(found) // 2][0]:.0e}."
        )
        for _, row in found:
            if "errors" in row:
                ours, theirs = row["errors"]
                lines.append(
                    f"{row['robot'].rpartition('/')[2]} at its worst state, against 50 digits: the "
                    f"largest error is {ours:.1g} here and {theirs:.1g} in {peer}."
                )
    moved = [row for row in loaded if isinstance(row.get("motion_m"), float)]
    stopped = [row for row in loaded if isinstance(row.get("motion_m"), str)]
    if moved:
        worst = max(moved, key=lambda row: row["motion_m"])
        lines.append(
            f"1 s of motion of {len(moved)} robots differs from MuJoCo by at most "
            f"{worst['motion_m']:.1g} m ({worst['robot'].rpartition('/')[2]}); positions change by up to "
            f"{max(row['moved_m'] for row in moved):.1f} m. {len(stopped)} others are too stiff for steps "
            "of 1 ms: without armature, their damping stops a joint within less."
        )
    without = [row for row in loaded if "difference" not in row]
    if without:
        names = ", ".join(row["robot"].rpartition("/")[2] for row in without)
        lines.append(f"Not compared: {names} (loops or welds, which MuJoCo keeps only softly).")
    return lines


def _short(value):
    return f"{value:.1g}" if isinstance(value, float) else "-"
