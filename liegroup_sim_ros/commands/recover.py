# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim recover`: write a readable file from a truncated or damaged recording.

Exit code 0 if a file was written or the recording is complete; 2 with one line of text if the file
has no readable content or the new file cannot be written.
"""

import sys
from pathlib import Path

from rich.console import Console

from liegroup_sim_ros.numbers import counted
from liegroup_sim_ros.recording.damaged_recover import write_recovered
from liegroup_sim_ros.recording.damaged_survey import survey

from .info import listed, topics_table


def add_arguments(parser):
    """Arguments of the subcommand."""
    parser.description = (
        "Write a new file with all intact messages of a recording that is damaged or "
        "was not finished (killed process, power failure, full disk), and report what is missing. "
        "Every MCAP reader opens the new file. FILE is not changed."
    )
    parser.add_argument("log", metavar="FILE", help="recording (*.mcap)")
    parser.add_argument("-o", "--out", metavar="OUT", help="new file (default: FILE with suffix _recovered)")


def run(args):
    """Run the subcommand; returns the exit code. Raises RecordingError."""
    path = Path(args.log)
    out = Path(args.out) if args.out else path.with_name(f"{path.stem}_recovered.mcap")
    with Console(stderr=True).status("reading"):
        found = survey(path)
    lost = sum(found.lost.values())
    if found.complete:
        print(
            f"{path}: complete, {counted(found.count, 'message')}; there is nothing to recover"
            + (f"; dropped before they were written: {counted(lost, 'message')}" if lost else "")
        )
        return 0
    with Console(stderr=True).status("writing"):
        written = write_recovered(found, out)
    for problem in listed(found.problems):
        print(f"{path}: {problem}")
    if found.unfinished:
        print(f"{path}: from a truncated chunk: {counted(found.unfinished, 'message')}")
    if not written:
        print(f"{out}: no messages, only attachments and metadata")
        return 0
    first, last = (stamp * 1e-9 for stamp in found.stamps)
    Console(file=sys.stdout).print(topics_table(found))
    has_end = any(name == "pacing.json" for name, _, _ in found.attachments)
    print(
        f"{out}: {counted(written, 'message')} from {first:.9g} s to {last:.9g} s, {lost} missing in "
        "between; " + ("the end of the run is included" if has_end else "the end of the run is missing")
    )
    return 0
