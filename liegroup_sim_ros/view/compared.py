# SPDX-License-Identifier: Apache-2.0
"""Sources of a page: a machine along its log, and the fitted model as its ghost."""

from liegroup_core.identification.motions import motions

from .source import Frame, Known


class Along(Known):
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
    machine, model = Along(layout, f"log of {layout.scene.name}", "pale: the model"), Along(layout, "model", "fitted")
    for time, one, other in motions(found):
        machine.history.add(Frame(time, one, None))
        model.history.add(Frame(time, other, None))
    machine.tell(machine.history.times[0], "verdict", found.verdict)
    return machine, model
