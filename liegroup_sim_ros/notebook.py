# SPDX-License-Identifier: Apache-2.0
"""`show`: the HTML report of a recording or a simulation, in a notebook cell or in the browser."""

import math
import tempfile
import time
import webbrowser
from html import escape
from os import PathLike
from pathlib import Path

from liegroup_core.engine import Engine
from liegroup_core.errors import LieGroupSimError
from liegroup_sim_ros.analysis import analyse
from liegroup_sim_ros.playback.rerun import make_simulation
from liegroup_sim_ros.recording import attachments, read_recording
from liegroup_sim_ros.recording.read import Recording
from liegroup_sim_ros.recording.write_run import LogFile
from liegroup_sim_ros.report.page import make_page, page_part

FRAMES_PER_SECOND = 100  # samples of a simulation that is shown


class Shown:
    """HTML report; a notebook cell that ends with it displays it.

    html    : self-contained page
    verdict : first line of the report
    height  : height of the frame in the cell, px
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
    what: str | PathLike[str] | Recording | Engine,
    seconds: float | None = None,
    reference: bool = True,
    height: int = 900,
) -> Shown:
    """HTML report of a recording, or of the next seconds of a simulation: motion, plots, tables.

    what      : path or address of a recording, a Recording, or a Simulation. A Simulation is not
                changed: a copy continues from its current state, with its wrenches and commands
    seconds   : simulated time to show; of a Simulation, required
    reference : False: skip the comparison with a reference integration
    height    : px, of the frame in a notebook cell
    raises LieGroupSimError for a recording that cannot be read or written, ValueError for wrong
    arguments. A simulation that stops early is shown up to that time; the report gives the reason
    """
    if isinstance(what, Engine):
        if seconds is None or not 0.0 < seconds < math.inf:
            raise ValueError(f"seconds must be a positive number for a Simulation, got {seconds!r}")
        with tempfile.TemporaryDirectory(prefix="liegroup_sim_") as folder:
            path = _record(what, seconds, Path(folder) / "run.mcap")
            return _report(read_recording(str(path)), reference, height)
    if seconds is not None:
        raise ValueError("seconds requires a Simulation; a recording is always shown completely")
    recording = what if isinstance(what, Recording) else read_recording(str(what))
    return _report(recording, reference, height)


class Live:
    """Live page of a simulation, a node or a recording; a notebook cell that ends with it displays it.

    address : of the page
    source  : what it shows, see liegroup_sim_ros.view.source
    """

    def __init__(self, page, height):
        self._page, self.height = page, height
        self.address = page.address

    @property
    def source(self):
        """Present source of the page."""
        return self._page.source

    def _repr_html_(self) -> str:
        return f'<iframe src="{escape(self.address, quote=True)}" width="100%" height="{self.height}"></iframe>'

    def __repr__(self) -> str:
        return f"Live page: {self.address}"

    def close(self) -> None:
        """End the page and its simulation."""
        source = self._page.source
        self._page.stop()
        source.close()


def live(
    what: str | PathLike[str] | Engine, paused: bool = False, record: str = "", height: int = 700, port: int = 8090
) -> Live:
    """Live page of a simulation: it runs in real time, and the mouse pulls at it.

    what   : a Simulation, of which a copy continues from its present state; path of a recording; or name of a
             running node, such as "/sim_node"
    record : path of a recording (*.mcap) of the simulation
    raises LieGroupSimError: viser is not installed, or `what` is not found
    """
    from liegroup_sim_ros.view.local import Local
    from liegroup_sim_ros.view.page import Page
    from liegroup_sim_ros.view.recorded import Recorded

    if isinstance(what, Engine):
        copy = _copied(what, 1)
        source = Local(copy, what.scene.name, record, what.time_ns, paused)
    elif str(what).startswith("/") and not Path(what).exists():
        from liegroup_sim_ros.view.remote import Remote

        source = Remote(str(what))
    else:
        source = Recorded(str(what))
    try:
        page = Page(source, port=port)
    except Exception:
        source.close()
        raise
    page.start()
    return Live(page, height)


def _report(recording, reference, height):
    analysis = analyse(recording, reference)
    return Shown(make_page([page_part(analysis)]), analysis.figures["verdict"], height)


def _copied(simulation, every):
    """Simulation with the settings and the state of another one; every: steps between its samples."""
    with_errors = simulation.sample().errors is not None
    copy = make_simulation(simulation.scene, attachments.settings(simulation, every), estimate=with_errors)
    copy.start_from(simulation)
    return copy


def _record(simulation, seconds, path):
    """Record a copy of a simulation from its current state, with its inputs; returns the path."""
    step = simulation.step
    every = max(1, round(1.0 / (FRAMES_PER_SECOND * step)))
    count = max(1, round(seconds / (every * step)))
    copy = _copied(simulation, every)
    started, stopped = time.monotonic(), None
    with LogFile(path, copy, every, count + 1) as file:
        file.sample(copy.sample())
        try:
            for _ in range(count):
                copy.advance(every)
                file.sample(copy.sample())
        except LieGroupSimError as error:
            stopped = str(error)
        file.finish(copy, stopped, stopped is not None, time.monotonic() - started)
    return path
