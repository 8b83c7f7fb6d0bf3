# SPDX-License-Identifier: Apache-2.0
"""`show`: the HTML report of a recording or a simulation, in a notebook cell or in the browser."""

import copy
import tempfile
import webbrowser
from html import escape
from os import PathLike
from pathlib import Path

from liegroup_core.engine import Engine
from liegroup_core.errors import LieGroupSimError
from liegroup_sim_ros.analysis import analyse
from liegroup_sim_ros.recording import read_recording
from liegroup_sim_ros.recording.write_run import LogFile
from liegroup_sim_ros.report.page import make_page, page_part

FRAMES_PER_SECOND = 100  # samples of a simulation that is shown


class Shown:
    """A report: shows itself as the last line of a notebook cell.

    html    : the report, a self-contained page
    verdict : its first line
    height  : px, of the frame in the cell
    """

    def __init__(self, html: str, verdict: str, height: int):
        self.html, self.verdict, self.height = html, verdict, height

    def _repr_html_(self) -> str:
        return (
            f'<iframe srcdoc="{escape(self.html, quote=True)}" width="100%" '
            f'height="{self.height}" frameborder="0" sandbox="allow-scripts"></iframe>'
        )

    def __repr__(self) -> str:
        return self.verdict

    def save(self, path: str | PathLike[str]) -> Path:
        """Write the page to a file; returns its path."""
        path = Path(path)
        path.write_text(self.html, encoding="utf-8")
        return path

    def open(self) -> Path:
        """Open the page in the browser, from a temporary file; returns its path."""
        with tempfile.NamedTemporaryFile(
            "w", encoding="utf-8", prefix="liegroup_sim_", suffix=".html", delete=False
        ) as file:
            file.write(self.html)
        webbrowser.open(Path(file.name).as_uri())
        return Path(file.name)


def show(
    what: str | PathLike[str] | Engine,
    seconds: float | None = None,
    reference: bool = True,
    height: int = 900,
) -> Shown:
    """Report of a recording, or of a simulation over the next seconds: motion, curves, figures.

    what      : path or address of a recording, or a Simulation. A copy of it is simulated from its
                present state; it stays as it is
    seconds   : simulated time to show; of a Simulation, required
    reference : False: skip the comparison with a reference integration
    height    : px, of the frame in a notebook cell
    raises LieGroupSimError for a recording that cannot be read or a simulation that stops,
    ValueError for wrong arguments
    """
    if isinstance(what, Engine):
        if seconds is None or not seconds > 0.0:
            raise ValueError(f"show a simulation over how many seconds? got {seconds!r}")
        with tempfile.TemporaryDirectory(prefix="liegroup_sim_") as folder:
            return _report(_record(what, seconds, Path(folder) / "run.mcap"), reference, height)
    if seconds is not None:
        raise ValueError("seconds requires a Simulation; a recording is shown whole")
    return _report(what, reference, height)


def _report(path, reference, height):
    analysis = analyse(read_recording(str(path)), reference)
    return Shown(make_page([page_part(analysis)]), analysis.figures["verdict"], height)


def _record(simulation, seconds, path):
    """Record a copy of a simulation from its present state; returns the path."""
    simulation = copy.copy(simulation)
    step = simulation.step
    every = max(1, round(1.0 / (FRAMES_PER_SECOND * step)))
    count = max(1, round(seconds / (every * step)))
    stopped = None
    with LogFile(path, simulation, every, count + 1) as file:
        file.sample(simulation.sample())
        try:
            for _ in range(count):
                simulation.advance(every)
                file.sample(simulation.sample())
        except LieGroupSimError as error:
            stopped = str(error)
        file.finish(simulation, stopped, stopped is not None, 0.0)
    return path
