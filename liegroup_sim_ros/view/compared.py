# SPDX-License-Identifier: Apache-2.0
"""Sources of a page: a machine along its log, and the fitted model as its ghost."""

from liegroup_core.identification.motions import motions

from .source import Known, ViewFrame


class LoggedMotion(Known):
    """Motion along a log, whose frames are added to its history.

    layout : Layout of the scene
    title, how : for the page
    """

    state = "measured"

    def __init__(self, layout, title, how):
        super().__init__(layout, title)
        self.how = how


def sources_of(found):
    """(Source of the machine, Source of the fitted model) of a Comparison."""
    layout = found.fit.runs.machine(found.solution.point.values).layout
    machine = LoggedMotion(layout, f"log of {layout.scene.name}", "pale: the model")
    model = LoggedMotion(layout, "model", "fitted")
    for time, one, other in motions(found):
        machine.history.add(ViewFrame(time, one, None))
        model.history.add(ViewFrame(time, other, None))
    machine.tell(machine.history.times[0], "verdict", found.verdict)
    return machine, model
