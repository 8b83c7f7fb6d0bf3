# SPDX-License-Identifier: Apache-2.0
"""Controls and figures beside the 3-D view: state, time line, plots, joints, events, what is drawn, saving."""

import itertools
import math
from html import escape

import numpy as np

from .export import save_html, save_picture, save_video

SMALLEST = 1e-17  # value whose logarithm stands for zero
SECONDS = 20.0  # of the curves of a live source
MOST_LINES = 60  # events that are shown
MOST_JOINTS = 60  # joints with sliders
MOST_POWER = 15  # of ten, by which a halo magnifies an error
SPEEDS = ("0.01", "0.1", "0.5", "1", "2", "5", "10")
BAD = "#c03030"
LINE = "white-space:nowrap;overflow:hidden;text-overflow:ellipsis"
# Of a slider whose joint has no limits.
ROUND, REACH = math.pi, 1.0  # rad; of the size of the mechanism


class Panel:
    """Panel of a Page; gui : viser's."""

    repeats = True  # a recording starts again at its end

    def __init__(self, page, gui):
        self._page, self._gui, self._parts, self._lines = page, gui, [], []
        self.has_changed = True
        self.rebuild()

    def rebuild(self):
        """Make all controls anew, for another source."""
        for part in self._parts:
            part.remove()
        self._sliders, self._setting = {}, False
        gui, source = self._gui, self._page.source
        self._state = gui.add_html("")
        self._run_row = self._running(source)
        self._time = self._time_line()
        tabs = gui.add_tab_group()
        with tabs.add_tab("Motion"):
            self._motion()
        if source.takes & {"effort", "servo", "driven", "place"}:
            with tabs.add_tab("Joints"):
                self._joints(source)
        with tabs.add_tab("Events"):
            self._events = gui.add_html("")
        with tabs.add_tab("Show"):
            self._show()
        with tabs.add_tab("Save"):
            self._save(source)
        self._parts = [self._state, *self._run_row, *self._time, tabs]

    def _button(self, label, action, **options):
        button = self._gui.add_button(label, **options)
        button.on_click(lambda _: self._page.attempt(action))
        return button

    def _running(self, source):
        page, gui, parts = self._page, self._gui, []
        if not source.is_live:
            play = gui.add_button("Play / pause")
            play.on_click(lambda _: setattr(page, "playing", not page.playing))
            speed = gui.add_dropdown("speed", SPEEDS, initial_value="1")
            speed.on_update(lambda _: setattr(page, "play_speed", float(speed.value)))
            return [play, speed]
        if "pause" in source.takes:
            group = gui.add_button_group("run", ("Run", "Pause", "Step", "Reset"))
            commands = {"Run": ("resume",), "Pause": ("pause",), "Step": ("step", 1), "Reset": ("reset",)}
            group.on_click(lambda _: page.attempt(source.ask, *commands[group.value]))
            parts.append(group)
        if "speed" in source.takes:
            speed = gui.add_dropdown("real-time factor", SPEEDS, initial_value="1")
            speed.on_update(lambda _: page.attempt(source.ask, "speed", float(speed.value)))
            parts.append(speed)
        return parts

    def _time_line(self):
        page, gui = self._page, self._gui
        slider = gui.add_slider("time", 0.0, 1.0, 0.001, 0.0, hint="part of the time that was seen")

        def moved(event):
            if event.client is None:  # by `update`
                return
            first, last = page.source.history.span()
            page.cursor, page.playing = first + slider.value * (last - first), False
            page._drawing.forget_trace()

        slider.on_update(moved)
        parts = [slider]
        if page.source.is_live:
            live = gui.add_button("Back to the present", visible=False)
            live.on_click(lambda _: setattr(page, "cursor", None))
            parts.append(live)
            self._live = live
        parts.append(self._button("Branch from here", self._branch, hint="continue from this instant: what if"))
        return parts

    def _branch(self):
        page = self._page
        source, at = page.source, page.cursor
        if source.is_live and at is None:
            return "move the time line to where the branch shall begin"
        if "back" in source.takes:
            page.attempt(source.ask, "pause")
            kept, now = source.ask("back", at)
            page.haunt(source.history, now - kept)
            page.cursor = None
            return f"continues from {kept:.6g} s; the former motion is the pale one"
        at = source.history.span()[0] if at is None else at
        branch = source.branch(at)
        page.exchange(branch)
        page.haunt(source.history, 0.0)
        return f"continues from {at:.6g} s, paused; the former motion is the pale one"

    def _motion(self):
        gui, layout = self._gui, self._page.source.layout
        self._error = self._plot("log10 of the estimated error in m", ("largest", "requested"))
        self._energy = self._plot("change of the energy, J", ("energy",))
        names = layout.coordinates.names
        self._joint = gui.add_dropdown("joint", tuple(names), initial_value=names[0]) if names else None
        self._position = self._plot("position", ("position",)) if names else None
        self._velocity = self._plot("velocity", ("velocity",)) if names else None
        with_efforts = names and self._page.source.knows_efforts
        self._effort = self._plot("effort of servo, drive and command", ("effort",)) if with_efforts else None
        self._apart = self._plot("log10 of the distance to the pale motion in m", ("distance",))

    def _plot(self, title, names):
        from viser import uplot

        colours = ("#c03030", "#3060c0")
        series = (uplot.Series(label="s"),) + tuple(
            uplot.Series(label=name, stroke=colour, width=2, spanGaps=False) for name, colour in zip(names, colours)
        )
        scales = {"x": uplot.Scale(time=False)}
        axes = (uplot.Axis(), uplot.Axis(size=64))
        empty = np.array([0.0, 1.0])
        data = (empty, *(np.full(2, 1.0) for _ in names))
        caption = self._gui.add_html("")
        return _Plot(title, caption, self._gui.add_uplot(data, series, scales=scales, axes=axes, height=170))

    def _joints(self, source):
        gui, layout = self._gui, source.layout
        limits, servos = layout.limits, set(layout.servos)
        movable = (
            joint for joint in layout.coordinates.names if joint in limits and limits[joint][2] < limits[joint][3]
        )
        shown = list(itertools.islice(movable, MOST_JOINTS))
        if "place" in source.takes:
            gui.add_html(
                "<div style='padding:0 12px;font-size:12px'>Paused, a slider moves its joint, and loops close again. "
                "Running, it commands the servo or the drive.</div>"
            )
        for joint in shown:
            unit, low, high = limits[joint][1:4]
            reach = ROUND if unit == "rad" else REACH * layout.size
            low, high = (low if math.isfinite(low) else -reach), (high if math.isfinite(high) else reach)
            kind = "driven" if joint in layout.motions else "servo" if joint in servos else "place"
            with gui.add_folder(joint, expand_by_default=len(shown) <= 3):
                slider = gui.add_slider(f"position, {unit}", low, high, (high - low) / 1000, min(max(0.0, low), high))
                slider.on_update(lambda event, j=joint, k=kind, s=slider: self._moved(event, j, k, s.value))
                if "effort" in source.takes and joint in layout.unit_efforts:
                    effort = gui.add_number(f"effort, {'N m' if unit == 'rad' else 'N'}", 0.0, step=0.1)
                    effort.on_update(lambda event, j=joint, e=effort: self._pressed(event, j, e.value))
            self._sliders[joint] = slider

    def _moved(self, event, joint, kind, value):
        if event.client is None:
            return
        page = self._page
        paused = page.source.status().state == "paused"
        if paused or kind == "place":
            page.attempt(page.source.ask, "place", {joint: value})
        else:
            page.attempt(page.source.ask, kind, joint, value)

    def _pressed(self, event, joint, value):
        if event.client is not None:
            self._page.attempt(self._page.source.ask, "effort", joint, value)

    def _show(self):
        gui, page = self._gui, self._page
        labels = {
            "joints": "joints",
            "frames": "body frames",
            "wrenches": "applied wrenches",
            "reactions": "reactions",
            "gravity": "gravity",
            "trace": "traces",
            "halo": "estimated error as a halo",
        }
        for field, label in labels.items():
            box = gui.add_checkbox(label, getattr(page.look, field))
            box.on_update(lambda _, f=field, b=box: self._look(**{f: b.value}))
        present = min(max(round(math.log10(page.look.magnification)), 0), MOST_POWER)
        power = gui.add_slider("halo: error times 10 to the power of", 0, MOST_POWER, 1, present)
        power.on_update(lambda _: self._look(magnification=10.0**power.value))

    def _look(self, **changed):
        self._page.look = self._page.look._replace(**changed)
        self.has_changed = True

    def _save(self, source):
        gui, page = self._gui, self._page
        if "save" in source.takes:
            name = gui.add_text("snapshot", "first")
            self._button("Save snapshot", lambda: source.ask("save", name.value))
            self._button("Return to snapshot", lambda: source.ask("restore", name.value))
        if "accuracy" in source.takes:
            accuracy = gui.add_text("accuracy", "1e-6")
            self._button("Set accuracy", lambda: source.ask("accuracy", float(accuracy.value)))
        for label, save in (("Picture", save_picture), ("Video", save_video), ("Page to keep (HTML)", save_html)):
            button = gui.add_button(label)
            button.on_click(lambda event, save=save: page.attempt(save, page, event.client))

    def note(self, text, failed=False):
        """Show one line among the events."""
        at = self._page.seen()
        self._lines = [*self._lines[1 - MOST_LINES :], (None if at is None else at.time, text, failed)]

    def update(self, frame):
        """Show the figures of a Frame, at a low rate."""
        page, source = self._page, self._page.source
        for at, name, text in source.events():
            failed = name in ("fault", "refused", "unrecorded", "slow", "inaccurate")
            self._lines = [*self._lines[1 - MOST_LINES :], (at, f"{name}: {text}", failed)]
        self._state.content = self._headline(frame)
        rows = "".join(
            f'<div style="{LINE};color:{BAD if failed else "inherit"}" title="{escape(text)}">'
            f"{'' if at is None else f'{at:.3f} s '}{escape(text)}</div>"
            for at, text, failed in reversed(self._lines)
        )
        self._events.content = (
            f'<div style="padding:4px 12px;font-size:12px;max-height:300px;overflow-y:auto">{rows}</div>'
        )
        if frame is None or not source.history.times:
            return
        first, last = source.history.span()
        if page.source.is_live:
            self._live.visible = page.cursor is not None
        if page.cursor is None or page.playing:
            at = 1.0 if page.cursor is None else (page.cursor - first) / (last - first or 1.0)
            self._time[0].value = round(min(max(at, 0.0), 1.0), 3)
        self._plots(frame, first if not source.is_live else max(first, last - SECONDS))

    def _headline(self, frame):
        source = self._page.source
        status = source.status()
        lines = [f"<b>{escape(source.title)}</b>"]
        if frame is not None:
            lines.append(f"t = {frame.time:.3f} s, {escape(status.state)}")
            errors, bound = frame.sample.errors, frame.bound
            if errors is not None and np.isfinite(errors[:, 0]).any():
                text = f"estimated error {np.nanmax(errors[:, 0]):.1e} m, {np.nanmax(errors[:, 1]):.1e} rad"
                lines.append(text)
                if bound:
                    lines.append(f"requested {bound[0]:.1e} m, {bound[1]:.1e} rad")
        if status.factor is not None and status.state == "running":
            late = f", latency {status.latency * 1e3:.0f} ms" if status.latency is not None else ""
            lines.append(f"real-time factor {status.factor:.2f}{late}")
        hand = self._page._hand
        if hand is not None and hand.shown:
            lines.append(f"<b>pull {escape(hand.shown)}</b>")
        if status.text:
            lines.append(f'<span style="color:{BAD}">{escape(status.text)}</span>')
        shown = "".join(f'<div style="{LINE}">{line}</div>' for line in lines)
        return f'<div style="padding:4px 12px;font-size:13px">{shown}</div>'

    def _plots(self, frame, since):
        history = self._page.source.history
        base = history.frames[0].sample.energy

        def largest(f):
            errors = f.sample.errors
            return np.nan if errors is None or not np.isfinite(errors[:, 0]).any() else _log10(np.nanmax(errors[:, 0]))

        self._draw(self._error, history, since, (largest, lambda f: _log10(f.bound[0]) if f.bound else np.nan))
        self._draw(self._energy, history, since, (lambda f: f.sample.energy - base,))
        if self._joint is not None:
            joint = self._joint.value
            coordinates = lambda f: f.sample.joint_coordinates.get(joint, (np.nan, np.nan))  # noqa: E731
            self._draw(self._position, history, since, (lambda f: coordinates(f)[0],))
            self._draw(self._velocity, history, since, (lambda f: coordinates(f)[1],))
            dressed = self._page.source.dressed
            if self._effort is not None:
                self._draw(self._effort, history, since, (lambda f: dressed(f).sample.all_efforts.get(joint, np.nan),))
        has_other = self._page._ghost is not None
        self._apart.visible = has_other
        if has_other:
            self._draw(self._apart, history, since, (self._distance,))
        for joint, slider in self._sliders.items():
            if self._page.source.status().state == "running" and joint in frame.sample.joint_coordinates:
                position = frame.sample.joint_coordinates[joint][0]
                if slider.min <= position <= slider.max:
                    slider.value = position

    def _distance(self, frame):
        other = self._page.other(frame)
        if other is None:
            return np.nan
        return _log10(np.linalg.norm(frame.sample.rows[:, :3] - other.sample.rows[:, :3], axis=1).max())

    @staticmethod
    def _draw(plot, history, since, values):
        curves = [history.curve(value, since) for value in values]
        times = curves[0][0]
        if len(times) < 2:
            return
        found = [curve for _, curve in curves]
        largest = max((np.abs(curve[np.isfinite(curve)]).max(initial=0.0) for curve in found), default=0.0)
        power = math.floor(math.log10(largest)) if largest > 0.0 else 0
        power = 0 if -3 <= power <= 4 else power  # the axes have no exponents
        plot.name(power)
        plot.plot.data = (times, *(curve * 10.0**-power for curve in found))


class _Plot:
    """Plot with its caption, which has the power of ten of the numbers at the axis."""

    def __init__(self, title, caption, plot):
        self._title, self._caption, self.plot = title, caption, plot
        self.name(0)

    def name(self, power):
        """Show the power of ten."""
        shown = self._title + (f" / 1e{power}" if power else "")
        self._caption.content = f'<div style="padding:6px 12px 0;font-size:12px">{shown}</div>'

    @property
    def visible(self):
        """Whether it is shown."""
        return self.plot.visible

    @visible.setter
    def visible(self, visible):
        self._caption.visible = self.plot.visible = visible


def _log10(value):
    return math.log10(max(float(value), SMALLEST))
