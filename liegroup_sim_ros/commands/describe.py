# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim describe`: degrees of freedom, conserved quantities and cost per step of a scene.

The cost of a step is measured here. All other facts come from liegroup_core.describe. No ROS.
"""

import json
import sys
import time

from rich.console import Console
from rich.text import Text

from liegroup_core import SimulationError
from liegroup_core.describe import describe
from liegroup_core.engine import Engine
from liegroup_core.layout import make_layout
from liegroup_core.methods import table as registered
from liegroup_sim_ros.numbers import NO_MOMENTUM, counted
from liegroup_sim_ros.report.terminal import section

from .robot_options import add_robot_options, robot_scene

METHODS = ("rkmk4", "rkmk8")
MEASURING, LEAST_RUNS = 0.2, 3  # per method: time in s, and minimum number of runs; the fastest run counts
STEP = 1e-5  # s, small enough for every scene
MOST_ROWS = 40  # printed rows of a list; JSON contains all


def add_arguments(parser):
    """Arguments of the subcommand."""
    parser.description = (
        "Summarise a scene: bodies, joints, forces, degrees of freedom, redundant constraint "
        "equations, structure of the solve, conserved quantities, and the measured cost of a "
        "step on this machine."
    )
    parser.add_argument("scene", metavar="SCENE", help="path of a scene or robot file, or name of an example scene")
    parser.add_argument("--json", action="store_true", help="print JSON")
    add_robot_options(parser)


def run(args):
    """Run the subcommand; returns the exit code. Raises SceneError."""
    scene = robot_scene(args.scene, args)
    layout = make_layout(scene)
    facts = describe(layout)
    with Console(stderr=True).status("measuring (the first run of a kind of mechanism compiles)"):
        facts["cost"] = {method: step_cost(scene, method) for method in METHODS if method in facts["methods"]}
    if args.json:
        print(json.dumps(facts, indent=1, allow_nan=False))
    else:
        print_facts(facts, Console(file=sys.stdout))
    return 0


def step_cost(scene, method, seconds=MEASURING):
    """Measured cost of a step: {"step_us", "stage_us", "runs", "steps"}, or {"failed": text}.

    step_us, stage_us : time of a step and of each of its stages, the minimum of several runs of many steps,
                        because other load on the machine can only add time
    """
    simulation = Engine(scene, method, STEP, quiet=True)
    steps, times = 1, []
    end = time.perf_counter() + seconds
    try:
        while time.perf_counter() < end or len(times) < LEAST_RUNS:
            simulation.reset()
            start = time.perf_counter()
            simulation.advance(steps)
            taken = time.perf_counter() - start
            if taken < seconds / 40.0:  # too short to time
                steps *= 2
            else:
                times.append(taken / steps)
    except SimulationError as error:
        return {"failed": str(error)}
    step_us, stages = min(times) * 1e6, len(registered.METHODS[method].tableau.b)
    return {"step_us": step_us, "stage_us": step_us / stages, "runs": len(times), "steps": steps}


def print_facts(facts, console):
    """Print the facts as tables on a terminal."""
    console.print(Text(f"{facts['scene']}: {_freedoms(facts['degrees_of_freedom'])}", style="bold"))
    if facts["description"]:
        console.print(Text(facts["description"], style="dim"))
    for title, rows in sections(facts):
        if not rows:
            continue
        more = [(f"and {len(rows) - MOST_ROWS} more", "", "--json prints all")] if len(rows) > MOST_ROWS else []
        console.print()
        console.print(section(title, [*rows[:MOST_ROWS], *more]))


def _polynomial(entry):
    """Text of the terms of a coupling in the coordinates of its other joints."""
    q = entry["other"]
    terms = [(entry["ratio"], q), *((a, f"{q}^{k}") for k, a in enumerate(entry["curve"], 2))]
    terms += [(c, name) for name, c in entry["terms"].items()]
    return " + ".join(f"{a:.6g} {name}" for a, name in terms)


def _unit(joint):
    return "kg" if joint["type"] == "prismatic" else "kg m^2"


def sections(facts):
    """Tables of a description: [(title, [(quantity, value, remark)])]."""
    return [
        ("Notes", [_note(text) for text in facts["notes"]]),
        ("Import", _import_rows(facts["import"])),
        ("Masses and sizes at the start, world axes", _mass_rows(facts["masses"])),
        (
            "Bodies: centres of mass, and inertias about them, body axes",
            [
                (
                    body["name"],
                    f"{body['mass']:.6g} kg",
                    f"at {_vector(body['com'])} m; inertia {_vector(body['inertia'])} kg m^2",
                )
                for body in facts["bodies"]
            ],
        ),
        (
            "Joints",
            [
                (
                    joint["name"],
                    joint["type"],
                    f"{joint['parent']} - {joint['child']}"
                    + (", driven" if joint["driven"] else "")
                    + (f", rotor {joint['rotor']:.6g} {_unit(joint)}" if joint["rotor"] else "")
                    + (f", eliminated: {' '.join(joint['dropped'])}" if joint["dropped"] else ""),
                )
                for joint in facts["joints"]
            ],
        ),
        ("Stops and friction", [_switch_row(entry) for entry in facts["stops_and_friction"]]),
        (
            "Couplings",
            [
                (entry["name"], entry["joint"], f"= {_polynomial(entry)} + {entry['offset']:.6g}")
                for entry in facts["couplings"]
            ],
        ),
        ("Forces", [_force_row(force) for force in facts["forces"]]),
        ("Sensors", [(each["name"], each["type"], " - ".join(each["on"])) for each in facts["sensors"]]),
        ("Degrees of freedom", _freedom_rows(facts)),
        ("Reactions", [(joint, "undetermined", why) for joint, why in facts["undetermined"].items()]),
        ("Formulation", _formulation_rows(facts["formulation"], len(facts["bodies"]), facts["plane"])),
        ("Spanning tree", _tree_rows(facts["formulation"])),
        ("System of the cut joints", _solve_rows(facts["solve"])),
        ("Applicable methods", [("", ", ".join(facts["methods"]), "")]),
        ("Conserved quantities", _conserved_rows(facts)),
        (
            "Cost of a step on this machine",
            [
                (
                    method,
                    cost.get("failed") or f"{cost['step_us']:.3g} us",
                    ""
                    if "failed" in cost
                    else f"{cost['stage_us']:.2g} us a stage, forces included; fastest of "
                    f"{counted(cost['runs'], 'run')} of {counted(cost['steps'], 'step')}",
                )
                for method, cost in facts["cost"].items()
            ],
        ),
    ]


def _force_row(force):
    """Row of a force: its ends, or what a law acts on, its states and signals."""
    if force["type"] == "contact":
        return force["name"], "contact", _contact(force)
    if force["type"] != "law":
        return force["name"], force["type"], " - ".join(force["on"])
    parts = [("on", force["on"]), ("signals", force["signals"])]
    return force["name"], "law", "; ".join(f"{title} {', '.join(names)}" for title, names in parts if names)


def _contact(force):
    """Bodies and numbers of a contact."""
    ends, plane = [f"{kind} of {body}" for body, kind in force["shapes"].items()], force["plane"]
    ends += [f"plane through {_vector(plane['point'])}, normal {_vector(plane['normal'])}"] if plane else []
    text = f"{' - '.join(ends)}; stiffness {force['stiffness']:.4g} N/m, damping {force['damping']:.4g} s/m"
    if "friction" in force:
        text += f", friction {force['friction']:.4g}, slip {force['slip']:.4g} m, settles {force['settles']:.4g} s"
    return text


def _vector(values):
    return " ".join(f"{value:.4g}" for value in values)


def _mass_rows(facts):
    least, largest = facts["extents"]
    edges = _vector(high - low for low, high in zip(least, largest))
    return [
        ("total mass", f"{facts['mass']:.6g} kg", ""),
        ("centre of mass", f"{_vector(facts['centre_of_mass'])} m", ""),
        ("extents", f"{edges} m", f"from {_vector(least)} to {_vector(largest)}: joints, and boxes of equal inertia"),
    ]


def _switch_row(entry):
    """Row with stops and friction of a joint, and its modes."""
    named = {**(entry["limits"] or {}), **(entry["friction"] or {})}
    values = [f"{name} {value:.6g}" for name, value in named.items() if value is not None]
    return entry["joint"], ", ".join(values), f"modes: {', '.join(entry['modes'])}"


def _import_rows(facts):
    """Rows with the numbers of links and coordinates before and after the import of a robot."""
    if facts is None:
        return []
    rows = [
        ("links", f"{facts['links']} -> {counted(facts['bodies'], 'body')}", "fixed and locked joints merge"),
        (
            "joint coordinates",
            f"{facts['file_coordinates']} -> {facts['coordinates']}",
            "without locked, cut or held joints",
        ),
    ]
    return rows


def _freedoms(count):
    """Number of degrees of freedom in words."""
    return f"{counted(count, 'degree')} of freedom"


def _note(text):
    """Row (kind, text, "") of a note "kind: text"."""
    kind, separator, rest = text.partition(": ")
    return (kind, rest, "") if separator and len(kind) < 24 else ("", text, "")


def _formulation_rows(facts, bodies, plane):
    cut = [f"{entry['joint']} ({' '.join(entry['rows'])})" for entry in facts["cut"] if entry["rows"]]
    dropped = [f"{entry['joint']} ({' '.join(entry['dropped'])})" for entry in facts["cut"] if entry["dropped"]]
    welded = [" + ".join(link["bodies"]) for link in facts["tree"] if len(link["bodies"]) > 1]
    floating = [" + ".join(link["bodies"]) for link in facts["tree"] if link["joint"] is None]
    rows = [
        (
            "relative coordinates",
            str(facts["coordinates"]),
            f"joint positions of a spanning tree, for {6 * bodies} of poses; its joints are satisfied exactly",
        ),
        ("cut joints", ", ".join(cut) or "none", "with the rows that are solved" if cut else ""),
    ]
    if plane is not None:
        rows.append(("planar", f"across {plane}", "in relative coordinates bodies are integrated in the plane"))
    if dropped:
        rows.append(("redundant rows", ", ".join(dropped), "of the cut joints: eliminated"))
    if welded:
        rows.append(("merged bodies", ", ".join(welded), "welded by fixed joints"))
    if floating:
        rows.append(("floating", ", ".join(floating), "six coordinates each"))
    if facts["only"]:
        rows.append(("other groups", "none", facts["only"]))
    return rows


def _tree_rows(facts):
    return [
        (
            " + ".join(link["bodies"]),
            link["group"],
            f"joint {link['joint']} to {' + '.join(link['parent'])}" if link["joint"] else "floating",
        )
        for link in facts["tree"]
    ]


def _freedom_rows(facts):
    dropped = ", ".join(f"{joint} {row}" for joint, row in facts["dropped_rows"])
    driven = sum(joint["driven"] for joint in facts["joints"])
    return [
        ("coordinates", str(6 * len(facts["bodies"])), "six per body"),
        ("constraint equations", str(facts["rows"]), "of the joints"),
        (
            "eliminated",
            str(len(facts["dropped_rows"])),
            f"redundant among the joints of all bodies: {dropped}" if dropped else "none redundant",
        ),
        *([("couplings", str(len(facts["couplings"])), "one equation each")] if facts["couplings"] else []),
        *([("driven joints", str(driven), "one equation each")] if driven else []),
        ("degrees of freedom", str(facts["degrees_of_freedom"]), "remaining"),
    ]


def _solve_rows(solve):
    if not solve["rows"]:
        return []
    return [
        ("rows", str(solve["rows"]), "multipliers that every acceleration solves for"),
        ("numbers", str(solve["numbers"]), f"{solve['dense_share']:.3g} of a dense factor"),
        (
            "refinements",
            str(solve["refinements"]),
            "masses of neighbouring bodies differ strongly" if solve["refinements"] else "",
        ),
    ]


def _conserved_rows(facts):
    rows = [("groups of bodies", str(len(facts["groups"])), "; ".join(_listed(group) for group in facts["groups"][:6]))]
    rows += [
        ("momentum", component, _listed(conserved["bodies"]))
        for conserved in facts["kept_momentum"]
        for component in conserved["components"]
    ]
    return rows if facts["kept_momentum"] else rows + [("momentum", "-", NO_MOMENTUM)]


def _listed(names):
    more = f" and {len(names) - 6} more" if len(names) > 6 else ""
    return ", ".join(names[:6]) + more
