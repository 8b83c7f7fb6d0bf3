# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim info`: show the contents of recordings and whether they are complete.

Exit code 0, also for an incomplete recording; 2 with one line of text for a file that is not a recording.
"""

import json
import sys

from rich.console import Console

from liegroup_sim_ros.numbers import counted
from liegroup_sim_ros.recording import RecordingError
from liegroup_sim_ros.recording.check import is_promise
from liegroup_sim_ros.recording.damaged_survey import survey
from liegroup_sim_ros.recording.walk import clean
from liegroup_sim_ros.report.tables import TextTable, table_of
from liegroup_sim_ros.report.terminal import printed

# Entries of settings.json that are shown.
OF_SETTINGS = (
    *("scene", "method", "group", "step", "stabilisation", "promise", "steps_per_sample"),
    *("part", "previous", "wall_start", "versions", "machine"),
)


def add_arguments(parser):
    """Arguments of the subcommand."""
    parser.description = (
        "Show the contents of recordings: duration, scene, configuration, topics, attachments, "
        "dropped messages. Reads any MCAP file, also a truncated or damaged one."
    )
    parser.add_argument("logs", metavar="FILE", nargs="+", help="recording (*.mcap)")
    parser.add_argument("--json", action="store_true", help="print JSON: a list with one entry per file")


def run(args):
    """Run the subcommand; returns the exit code. Raises RecordingError after all files are read."""
    surveys, failures = [], []
    for path in args.logs:
        try:
            with Console(stderr=True).status("reading"):
                found = survey(path)
        except RecordingError as error:
            failures.append(error)
            continue
        if surveys and not args.json:
            print()
        surveys.append(as_json(found))
        if not args.json:
            print_survey(found, Console(file=sys.stdout))
    if args.json:
        print(json.dumps(surveys, indent=1, allow_nan=False))
    for error in failures[:-1]:
        print(f"liegroup_sim: {error}", file=sys.stderr)
    if failures:
        raise failures[-1]
    return 0


def as_json(found):
    """A Survey as JSON types; the keys are in docs/reference/recording.md."""
    settings, state = (found.contents.get(name, {}) for name in ("settings.json", "initial_state.json"))
    first, last = found.stamps
    return {
        "file": str(found.path),
        "bytes": found.size,
        "complete": found.complete,
        "problems": list(found.problems),
        "recovered_from": _recovered_from(found),
        "start_ns": first,
        "end_ns": last,
        "duration_s": (last - first) * 1e-9,
        "messages": found.count,
        "lost": sum(found.lost.values()),
        **{name: settings.get(name) for name in OF_SETTINGS},
        "start_step": state.get("steps"),
        "bodies": state.get("bodies"),
        "topics": [
            {"topic": channel.topic, "type": channel.type, "messages": tally.count, "rate_hz": tally.rate, "lost": lost}
            for channel, tally, lost in found.figures
        ],
        "attachments": [{"name": name, "media_type": kind, "bytes": size} for name, kind, size in found.attachments],
        "metadata": sorted(found.metadata),
        "library": found.header.library,
        "profile": found.header.profile,
    }


def print_survey(found, console):
    """Print a Survey as tables."""
    content = as_json(found)
    rows = []

    def row(name, text):
        rows.append((name, clean(text)))

    row("file", f"{found.path}, {found.size / 1e6:.3f} MB")
    if found.complete:
        row("complete", "yes" + (f", recovered from {content['recovered_from']}" if content["recovered_from"] else ""))
    else:
        row("complete", "no: " + "; ".join(listed(found.problems)))
        row("", "use `liegroup_sim recover` to make it readable")
    row(
        "duration",
        f"{content['duration_s']:.9g} s, from {content['start_ns'] * 1e-9:.9g} s to {content['end_ns'] * 1e-9:.9g} s",
    )
    row("messages", f"{found.count}, dropped: {content['lost']}")
    if content["scene"] is not None:
        promise, kept = content["promise"], ""
        if is_promise(promise):
            kept = f", accuracy {promise['accuracy']:g} in {promise['horizon']:g} s"
        row(
            "scene",
            f"{content['scene']}, {content['method']}{kept}, step {content['step']} s, "
            f"group {content['group']}, stabilisation {content['stabilisation']}",
        )
        row(
            "part",
            f"{content['part']}, from step {content['start_step']}"
            + (f", after {content['previous']}" if content["previous"] else ""),
        )
        row("created", f"{content['wall_start']}, {found.header.library}")
    else:
        row("created by", found.header.library or "unknown")
    row(
        "attachments",
        ", ".join(f"{name} ({counted(size, 'byte')})" for name, _, size in found.attachments[:20]) or "none",
    )
    console.print(printed(TextTable(None, ("", ""), rows, 2)))
    if found.channels:
        console.print()
        console.print(topics_table(found))


def topics_table(found):
    """Table of the topics of a Survey, for a terminal."""
    table = table_of(TOPICS, found.figures[:MOST_ROWS], folded=2)._replace(right=(2, 3, 4))
    if len(found.channels) > MOST_ROWS:
        table.rows.append((f"and {len(found.channels) - MOST_ROWS} more", "", "", "", ""))
    return printed(table)


def listed(problems):
    """[text of each problem, with its number] from {problem: number of occurrences}."""
    return [text + (f" ({n} times)" if n > 1 else "") for text, n in problems.items()]


def _rate(rate):
    return "" if rate is None else f"{rate:.3f}".rstrip("0").rstrip(".")


MOST_ROWS = 200
TOPICS = {
    "topic": lambda each: clean(each[0].topic),
    "type": lambda each: clean(each[0].type).replace("/msg/", "/"),
    "messages": lambda each: str(each[1].count),
    "per s": lambda each: _rate(each[1].rate),
    "dropped": lambda each: str(each[2]),
}


def _recovered_from(found):
    note = found.metadata.get("recovered", {})
    return note.get("from")
