# SPDX-License-Identifier: Apache-2.0
"""Controls and figures beside the 3-D view: state, time line, plots, joints, events, what is drawn, saving."""

import itertools
import math
import time
from html import escape

import numpy as np

from liegroup_core.engine import METHOD
from liegroup_core.observables.quantities import PLACES, RATES
from liegroup_core.settings import SETTINGS
from liegroup_sim_ros.messages.machine import AHEAD

from .export import save_html, save_picture, save_video
from .server import ViewError
from .source import SAME

SECONDS = 20.0  # of the curves of a live source
UNTOUCHED = 1.0  # s after the user has moved a slider, until sliders follow the motion again
TICK = 1e-3  # s, of the time line
MOST_LINES = 60  # events that are shown
MOST_JOINTS = 60  # joints with sliders
MOST_POWER = 15  # of ten, by which a halo magnifies an error
SPEEDS = ("0.01", "0.1", "0.5", "1", "2", "5", "10")
# The library's notice that a browser has no GPU would cover the mechanism.
ON_PHONES = "<style>@media (max-width: 576px) {#webgl-software-rendering {display: none}}</style>"
BAD, PLAIN = "#c03030", "#3060c0"
FAILURES = ("fault", "refused", "unrecorded", "slow", "inaccurate")  # events
AHEAD_NAMES = tuple(f"{ahead:g} s ahead" for ahead in AHEAD)  # curves of a machine
COLOURS = (PLAIN, "#808890", BAD, "#d08020")  # of the curves of a plot
WITH_GAPS = ("beyond it", "distance to the pale motion")
JOINT_PLOTS = {"position": "position", "velocity": "velocity", "effort": "effort of servo, drive and command"}
FIRST_CHOICE, MOST_CURVES = "positions, m", 4  # of the plot of any quantity
MOST_MARKS = 300  # events on the time line
# Of a slider whose joint has no limits.
ROUND, REACH = math.pi, 1.0  # rad; of the size of the mechanism


class Panel:
    """Panel of a Page; gui : viser's."""

    repeats = True  # a recording starts again at its end
    blocked = ""  # why no control works at present

    def __init__(self, page, gui):
        self._page, self._gui, self._parts, self._lines, self._marks = page, gui, [], [], []
        self.has_changed = True
        self.rebuild()

    def rebuild(self):
        """Make all controls anew, for another source."""
        for part in self._parts:
            part.remove()
        self._sliders, self._efforts, self._touched, self._chosen = {}, [], -math.inf, None
        gui, source = self._gui, self._page.source
        self._catalogue, self._functions = source.layout.catalogue, {}
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
            self._save()
        with tabs.add_tab("What if"):
            self._what_if(source)
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
            group.on_click(lambda _: page.go_on(*commands[group.value]))
            parts.append(group)
        if "speed" in source.takes:
            speed = gui.add_dropdown("real-time factor", SPEEDS, initial_value="1")
            speed.on_update(lambda _: page.attempt(source.ask, "speed", float(speed.value)))
            parts.append(speed)
        return parts

    def _time_line(self):
        page, gui = self._page, self._gui
        first, last = page.source.history.span()
        slider = gui.add_slider("time, s", first, max(last, first + TICK), TICK, first)

        def moved(event):
            if event.client is None:  # by `update`
                return
            page.cursor, page.playing = page.source.history.at(slider.value + SAME).time, False
            slider.value = page.cursor
            page._drawing.forget_trace()

        slider.on_update(moved)
        self._strip = gui.add_html("")
        parts = [slider, self._strip]
        if page.source.is_live:
            live = gui.add_button("Back to the present", visible=False)
            live.on_click(lambda _: setattr(page, "cursor", None))
            parts.append(live)
            self._live = live
        return parts

    def _branch(self):
        page = self._page
        source, at = page.source, page.cursor
        if source.is_live and at is None:
            return "move the time line to where the branch shall begin"
        if "back" in source.takes:
            former = source.history.until(math.inf)
            kept = source.ask("back", at)
            page.haunt(former, 0.0, kept)
            page.cursor = None
            return f"continues from {kept:.6g} s, paused; the former motion is the pale one"
        at = source.history.span()[0] if at is None else at
        branch = source.branch(at)
        page.exchange(branch)
        page.haunt(source.history, 0.0)
        return f"continues from {branch.frame().time:.6g} s, paused; the former motion is the pale one"

    def _motion(self):
        gui, layout, moves = self._gui, self._page.source.layout, self._page.source.is_motion
        title = "log10 of the error of predicting the machine, by its limit"
        self._machine = self._plot(title, AHEAD_NAMES) if self._page.source.compares else None
        curves = ("estimated", "requested", *WITH_GAPS)
        self._error = self._plot("log10 of the error, rad or relative to the size", curves) if moves else None
        self._energy = self._plot("change of the energy, J", ("energy",)) if moves else None
        names = layout.coordinates.names
        self._joint = gui.add_dropdown("joint", tuple(names), initial_value=names[0]) if names else None
        parts = JOINT_PLOTS if moves else ("position",)
        self._of_joint = {part: self._plot(JOINT_PLOTS[part], (part,)) for part in parts} if names else {}
        held = [joint.name for joint in layout.scene.joints] if moves else []
        self._held = gui.add_dropdown("reaction of", tuple(held), initial_value=held[0]) if held else None
        self._reaction = (
            self._plot("reaction as far as it is determined, N and N m", ("force", "torque")) if held else None
        )
        if moves:
            self._choose(gui)

    def _choose(self, gui):
        """Controls of a plot of any quantity: columns of one unit and of one body, joint, force or sensor."""
        self._choices = {}
        for group, quantity in self._catalogue.quantities.items():
            for name, unit in zip(quantity.names, quantity.units):
                own = self._choices.setdefault(f"{group}, {unit}" if unit else group, {})
                own.setdefault(name.rpartition(".")[0] or group, []).append(name)
        what = gui.add_dropdown("quantity", tuple(self._choices), initial_value=FIRST_CHOICE)
        owner = gui.add_dropdown("of", tuple(self._choices[FIRST_CHOICE]))
        what.on_update(lambda _: setattr(owner, "options", tuple(self._choices[what.value])))
        self._chosen = what, owner, self._plot("", ("",) * MOST_CURVES)

    def _plot(self, title, names):
        from viser import uplot

        # The library draws a line over a gap; curves with gaps are points.
        kinds = [
            {"width": 0, "points": {"show": True, "size": 3}} if name in WITH_GAPS else {"width": 2} for name in names
        ]
        series = (uplot.Series(label="s"),) + tuple(
            uplot.Series(label=name, stroke=colour, **kind) for name, colour, kind in zip(names, COLOURS, kinds)
        )
        scales = {"x": uplot.Scale(time=False)}
        axes = (uplot.Axis(), uplot.Axis(size=64))
        empty = np.array([0.0, 1.0])
        data = (empty, *(np.full(2, 1.0) for _ in names))
        caption = self._gui.add_html("")
        return _Plot(title, caption, self._gui.add_uplot(data, series, scales=scales, axes=axes, height=170))

    def _joints(self, source):
        gui, layout = self._gui, source.layout
        servos = layout.servos.keys() - layout.leaders.keys()
        movable = ((joint, *_range(layout, joint)) for joint in layout.coordinates.names if joint in layout.limits)
        shown = list(itertools.islice((each for each in movable if each[2] < each[3]), MOST_JOINTS))
        if "place" in source.takes:
            gui.add_html(
                "<div style='padding:0 12px;font-size:12px'>Paused, a slider moves its joint, and loops close again. "
                "Running, it commands the servo or the drive.</div>"
            )
        for joint, unit, low, high in shown:
            kind = "driven" if joint in layout.motions else "servo" if joint in servos else "place"
            with gui.add_folder(joint, expand_by_default=len(shown) <= 3):
                slider = gui.add_slider(f"position, {unit}", low, high, (high - low) / 1000, min(max(0.0, low), high))
                slider.on_update(lambda event, j=joint, k=kind, s=slider: self._moved(event, j, k, s.value))
                if "effort" in source.takes and joint in layout.unit_efforts:
                    effort = gui.add_number(f"effort, {'N m' if unit == 'rad' else 'N'}", 0.0, step=0.1)
                    effort.on_update(lambda event, j=joint, e=effort: self._pressed(event, j, e.value))
                    self._efforts.append(effort)
            self._sliders[joint] = slider

    def _moved(self, event, joint, kind, value):
        if event.client is None:
            return
        page, self._touched = self._page, time.monotonic()
        if page.cursor is not None:
            page.say("this is the past: go back to the present to move a joint", failed=True)
            return
        paused = page.source.status().state == "paused"
        if kind == "place" and not paused:
            page.say(f"{joint} has neither a servo nor a drive: pause the run to move it", failed=True)
        elif paused:
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
            "contacts": "contacts: points, green where they stick, and forces",
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

    def _what_if(self, source):
        gui = self._gui
        self._button("Branch from here", self._branch, hint="continue from the instant of the time line")
        if "reference" in source.takes:
            self._button("Compare with the reference", self._compare, hint="takes as long as analyze")
        if "save" in source.takes:
            name = gui.add_text("snapshot", "first")
            self._button("Save snapshot", lambda: source.tell_by_event("save", name.value))
            self._button("Return to snapshot", lambda: source.tell_by_event("restore", name.value))
        if "accuracy" in source.takes:
            accuracy = gui.add_text("accuracy", source.accuracy)
            self._button("Set accuracy", lambda: source.tell_by_event("accuracy", _number(accuracy.value)))
        if "method" in source.takes:
            method = gui.add_dropdown("method", SETTINGS["method"].choices, initial_value=METHOD)
            step = gui.add_number("step, s", SETTINGS["step"].default, min=1e-9, step=0.001)
            hint = "from the instant of the time line"
            self._button("Continue with this method", lambda: self._continue(method.value, step.value), hint=hint)

    def _compare(self):
        page = self._page
        self.note("the reference integration runs")
        history, text = page.source.reference()
        page.haunt(history, 0.0)
        return text

    def _continue(self, method, step):
        page, at = self._page, self._page.cursor
        before = page.source.history.until(math.inf)
        page.exchange(page.source.with_method(method, step, at))
        if at is None:
            page.haunt(None, 0.0)
            return f"continues with {method}, paused; go back on the time line first to compare with the former motion"
        page.haunt(before, 0.0)
        return f"continues with {method}, paused; the former motion is the pale one"

    def _save(self):
        gui, page = self._gui, self._page
        for label, save in (("Picture", save_picture), ("Video", save_video), ("Page to keep (HTML)", save_html)):
            button = gui.add_button(label)
            button.on_click(lambda event, save=save: page.attempt(save, page, event.client))

    def block(self, reason):
        """Disable all controls, which show it, and say why; "" enables them again."""
        import viser

        self.blocked = reason
        for handle in list(self._gui._gui_input_handle_from_uuid.values()):
            if isinstance(handle, viser.GuiButtonGroupHandle):  # it cannot be disabled
                handle.visible = not reason
            else:
                handle.disabled = bool(reason)

    def note(self, text, failed=False):
        """Show one line among the events."""
        at = self._page.seen()
        self._lines = [*self._lines[1 - MOST_LINES :], (None if at is None else at.time, text, failed)]

    def update(self, frame):
        """Show the figures of a ViewFrame, at a low rate."""
        page, source = self._page, self._page.source
        for at, name, text in source.events():
            if name in ("reset", "state"):  # commands have ended, and what comes later has not happened
                self._marks = [mark for mark in self._marks if mark[0] < at]
                text = text.partition("{")[0].strip()  # without the state itself
                for field in self._efforts:
                    field.value = 0.0
            failed = name in FAILURES or name == "machine" and "departs" in text
            self._lines = [*self._lines[1 - MOST_LINES :], (at, f"{name}: {text}", failed)]
            self._marks = [*self._marks[1 - MOST_MARKS :], (at, f"{at:.3f} s {name}: {text}", failed)]
        self._state.content = self._headline(frame)
        rows = "".join(
            f'<div style="overflow-wrap:anywhere;margin-bottom:3px;color:{BAD if failed else "inherit"}">'
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
            slider = self._time[0]
            slider.min, slider.max = first, max(last, first + TICK)
            slider.value = last if page.cursor is None else min(max(page.cursor, first), last)
        self._strip.content = _strip(self._marks, first, last, frame.time)
        self._plots(frame, first if not source.is_live else max(first, last - SECONDS))

    def _headline(self, frame):
        source = self._page.source
        status = source.status()
        lines = [f"<b>{escape(source.title)}</b>"]
        if frame is not None:
            lines.append(f"t = {frame.time:.3f} s, {escape(status.state)}")
            if source.how:
                lines.append(escape(source.how))
            errors, bound = frame.sample.errors, frame.bound
            if errors is not None and np.isfinite(errors[:, 0]).any():
                text = f"estimated error {np.nanmax(errors[:, 0]):.1e} m, {np.nanmax(errors[:, 1]):.1e} rad"
                lines.append(text)
                if bound:
                    lines.append(f"requested {bound[0]:.1e} m, {bound[1]:.1e} rad")
        if status.factor is not None and status.state == "running":
            late = f", latency {status.latency * 1e3:.0f} ms" if status.latency is not None else ""
            lines.append(f"real-time factor {status.factor:.2f}{late}")
        if frame is not None and math.isfinite(distance := self._page.distance(frame)):
            lines.append(f"distance to the pale motion {distance:.1e} m")
        hand = self._page._hand
        if hand is not None and hand.shown:
            lines.append(f"<b>pull {escape(hand.shown)}</b>")
        if self.blocked:
            lines.append(f"<b>{escape(self.blocked)}</b>")
        if status.text:
            lines.append(f'<span style="color:{BAD}">{escape(status.text)}</span>')
        shown = "".join(f'<div style="overflow-wrap:anywhere">{line}</div>' for line in lines)
        return f'{ON_PHONES}<div style="padding:4px 12px;font-size:13px">{shown}</div>'

    def _plots(self, frame, since):
        page = self._page
        history, dressed = page.source.history, page.source.dressed
        base, size = history.frames[0].sample.energy, page.source.layout.size
        estimated = lambda f: _estimated(f, size)  # noqa: E731
        errors = {
            "estimated": estimated,
            "requested": lambda f: f.bound[1] if f.bound else np.nan,
            "beyond": lambda f: estimated(f) if f.bound and estimated(f) > f.bound[1] else np.nan,
            f"distance {id(page._ghost)}": lambda f: page.distance(f) / size,
        }
        self._draw(self._error, history, since, {key: lambda f, v=v: _log10(v(f)) for key, v in errors.items()})
        ratios = {f"ratio {k}": lambda f, k=k: _log10(f.ratios[k]) if f.ratios else np.nan for k in range(len(AHEAD))}
        self._draw(self._machine, history, since, ratios)
        self._draw(self._energy, history, since, {"energy": lambda f: f.sample.energy - base})
        if self._joint is not None:
            for part, plot in self._of_joint.items():
                name = f"{self._joint.value}.{part}"
                if name in self._catalogue.places:
                    self._draw(plot, history, since, {name: self._function(name)})
        if self._chosen is not None:
            what, owner, plot = self._chosen
            names = self._choices[what.value].get(owner.value, ())
            plot.rename(what.value, [name.rpartition(".")[2] for name in names])
            curves = {name: self._function(name) for name in names}
            curves |= {f"no curve {k}": lambda _: np.nan for k in range(len(names), MOST_CURVES)}
            self._draw(plot, history, since, curves)
        if self._held is not None:
            held = self._held.value
            parts = {"force": slice(3, 6), "torque": slice(0, 3)}
            reaction = lambda f, part: _norm(dressed(f).sample.reactions.get(held), part)  # noqa: E731
            curves = {f"{key} {held}": lambda f, part=part: reaction(f, part) for key, part in parts.items()}
            self._draw(self._reaction, history, since, curves)
        for joint, slider in self._sliders.items():
            if time.monotonic() - self._touched > UNTOUCHED and joint in frame.sample.joint_coordinates:
                position = frame.sample.joint_coordinates[joint][0]
                if slider.min <= position <= slider.max:
                    slider.value = position

    def _function(self, name):
        """Function of a ViewFrame with the number of a column."""
        if name not in self._functions:
            columns, dressed = self._catalogue.columns([name]), self._page.source.dressed
            acts = columns.depends[0] not in (PLACES, RATES)
            self._functions[name] = lambda f: columns.of((dressed(f) if acts else f).sample)[0]
        return self._functions[name]

    @staticmethod
    def _draw(plot, history, since, values):
        """Draw {key: function of a ViewFrame} in a plot, see History.curve; None: no plot."""
        if plot is None:
            return
        curves = [history.curve(value, since, key) for key, value in values.items()]
        times = curves[0][0]
        if len(times) < 2:
            return
        found = [curve for _, curve in curves]
        largest = max((np.abs(curve[np.isfinite(curve)]).max(initial=0.0) for curve in found), default=0.0)
        power = math.floor(math.log10(largest)) if largest > 0.0 else 0
        power = 0 if -3 <= power <= 4 else power  # the axes have no exponents
        plot.name(power)
        plot.show(times, [curve * 10.0**-power for curve in found])


class _Plot:
    """Plot with its caption, which has the power of ten of the numbers at the axis."""

    def __init__(self, title, caption, plot):
        self._title, self._caption, self._plot = title, caption, plot
        self._known = [True] * (len(plot.series) - 1)
        self.name(0)

    def name(self, power):
        """Show the power of ten."""
        shown = self._title + (f" / 1e{power}" if power else "")
        self._caption.content = f'<div style="padding:6px 12px 0;font-size:12px">{shown}</div>'

    def rename(self, title, labels):
        """Change the caption and the labels of the curves; those without one keep theirs."""
        if title != self._title or labels != [series["label"] for series in self._plot.series[1 : len(labels) + 1]]:
            self._title, series = title, self._plot.series
            named = (s | {"label": label} for s, label in zip(series[1:], labels))
            self._plot.series = (series[0], *named, *series[len(labels) + 1 :])

    def show(self, times, curves):
        """Draw curves (k,), and hide those without a number.

        The library finds no range of an axis if a curve begins with NaN; then its second value is its first, or one
        that another curve hides.
        """
        plot, known = self._plot, [bool(np.isfinite(curve).any()) for curve in curves]
        if known != self._known:
            self._known = known
            plot.series = (plot.series[0], *(s | {"show": is_known} for s, is_known in zip(plot.series[1:], known)))
        numbers = np.concatenate(curves)
        hidden = next(iter(numbers[np.isfinite(numbers)]), 0.0)
        for curve in curves:
            if not np.isfinite(curve[0]):
                curve[0] = curve[1] if np.isfinite(curve[1]) else hidden
        plot.data = (times, *curves)


def _range(layout, joint):
    """(unit, least, largest position) of the slider of a joint: between its stops, and where it takes commands."""
    unit, low, high = layout.limits[joint][1:4]
    for limits in (switch.limits for switch in layout.switches if switch.name == joint and switch.limits):
        low, high = max(low, limits.least), min(high, limits.largest)
    reach = ROUND if unit == "rad" else REACH * layout.size
    low = low if math.isfinite(low) else min(-reach, high - reach)
    return unit, low, high if math.isfinite(high) else max(reach, low + reach)


def _log10(value):
    return math.log10(value) if value > 0.0 else math.nan


def _number(text):
    """Number of a text field. Raises ViewError."""
    try:
        return float(text)
    except ValueError:
        raise ViewError(f"{text!r} is no number: give one such as 1e-6") from None


def _estimated(frame, size):
    """Largest estimated error of a ViewFrame as the accuracy limits it: relative to the size, or in rad; or NaN."""
    errors = frame.sample.errors
    known = np.empty(0) if errors is None else (errors[:, :2] / (size, 1.0))[np.isfinite(errors[:, :2])]
    return known.max(initial=np.nan if not len(known) else 0.0)


def _norm(wrench, part):
    if wrench is None or not np.isfinite(wrench[part]).any():
        return np.nan
    return float(np.sqrt(np.nansum(wrench[part] ** 2)))


def _strip(marks, first, last, at):
    """Line below the slider: events of [(time, text, whether it is a failure)], and the time `at`, s."""
    place = lambda time: 100.0 * (time - first) / (last - first or 1.0)  # noqa: E731
    ticks = "".join(
        f'<div title="{escape(text)}" style="position:absolute;left:{place(time):.2f}%;top:{0 if failed else 3}px;'
        f'width:3px;height:{12 if failed else 6}px;background:{BAD if failed else PLAIN}"></div>'
        for time, text, failed in marks
        if first <= time <= last
    )
    return (
        '<div style="position:relative;height:12px;margin:2px 12px;border-bottom:1px solid #808890">'
        f'{ticks}<div style="position:absolute;left:{place(at):.2f}%;top:0;width:1px;height:12px;background:#808890">'
        "</div></div>"
    )
