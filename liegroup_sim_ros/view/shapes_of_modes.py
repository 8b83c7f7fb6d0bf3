# SPDX-License-Identifier: Apache-2.0
"""Source of a page: the shapes of the modes of a mechanism, one after the other."""

from liegroup_core import SimulationError
from liegroup_core.linear import shapes_of

from .server import ViewError
from .source import Known, ViewFrame

COUNT, RATE = 60, 30.0  # instants of a period, and of a second of the page
PERIODS, MOST = 2, 30  # of each mode; modes


class Modes(Known):
    """Modes [liegroup_core.linear.Mode] of a simulation, each for PERIODS periods. Raises ViewError for none.

    time   : s, of their state
    titles : texts of the modes
    """

    state = "shapes"

    def __init__(self, simulation, modes, titles, time=None):
        super().__init__(simulation.layout, f"{simulation.scene.name}: modes")
        self.how = "shapes of modes, not to scale"
        instant = 0
        for mode, title in list(zip(modes, titles))[:MOST]:
            try:
                samples = shapes_of(simulation, mode, COUNT, time)
            except SimulationError as error:
                raise ViewError(str(error)) from None
            self.tell(instant / RATE, "mode", title)
            for k in range(PERIODS * COUNT):
                self.history.add(ViewFrame(instant / RATE, samples[k % COUNT], None))
                instant += 1
        if not instant:
            raise ViewError(f"{simulation.scene.name}: has no mode to show")
