# SPDX-License-Identifier: Apache-2.0
"""Events of an Engine at joints with stops or dry friction, and of contacts: impacts, sticking, slipping."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from liegroup_core.events.switching import JointEvent, JointInstant
from liegroup_core.scene.description import Scene
from liegroup_core.scene.switches import switches_of

Floats = NDArray[np.float64]


class Impact(NamedTuple):
    """Impulses of all joints at an impact.

    time, time_ns : s, ns
    array         : (J, 6) N m s, N s of the joints of the scene on their children, with axes and NaN as
                    Sample.reactions
    names         : of the joints
    """

    time: float
    time_ns: int
    array: Floats
    names: tuple[str, ...]

    @property
    def impulses(self) -> dict[str, Floats]:
        """{joint: (6,)} N m s, N s."""
        return dict(zip(self.names, self.array))


def has_impacts(scene: Scene) -> bool:
    """Whether a joint or coupling of a scene has rigid stops."""
    limits = (switch.limits for switch in switches_of(scene))
    return any(some is not None and some.stiffness is None for some in limits)


class JointEvents:
    """Events of an Engine at joints with stops or friction, and of contacts; there are none without a Switching.

    parts : number of parts into which every step up to an event, of a stop, friction or an input, is divided
    """

    def __init__(self, layout, switching):
        self._layout, self._switching = layout, switching
        self._names = (*(switch.name for switch in layout.switches), *layout.touching.names)
        self.parts = 1

    @property
    def event_count(self) -> int:
        """Number of events at stops and of dry friction since the state was set."""
        return 0 if self._switching is None else self._switching.count

    def drain_events(self) -> list[JointEvent]:
        """Return the events of stops, dry friction and contacts since the last call, in order of time.

        At most the last 100 000 are kept. Contacts have none with fixed steps, which locate nothing.
        """
        if self._switching is None:
            return []
        events, self._switching.events[:] = self._switching.events[:], []
        return self._named(events)

    def _named(self, events):
        return [event._replace(joint=self._names[event.joint]) for event in events]

    @property
    def pending(self):
        """What was not drained yet; a state that is set discards it."""
        has = self._switching
        return None if has is None else (has.events, has.instants, has.impacts)

    @pending.setter
    def pending(self, pending):
        if pending is not None:
            has = self._switching
            has.events, has.instants, has.impacts = pending

    @property
    def lost_rebound(self):
        """Largest displacement of a rebound that became plastic since the state was set, see ModeChanges.lost."""
        return 0.0 if self._switching is None else self._switching.lost

    def drain_impacts(self) -> list[Impact]:
        """Return the impulses of all joints at the impacts since the last call.

        They are kept from the first call on. Impacts of a state that was set before are lost.
        """
        if self._switching is None:
            return []
        impacts, self._switching.impacts = self._switching.impacts or [], []
        found = []
        for time, *place, impulses in impacts:
            array = self._layout.reactions.of_impact(*place, impulses)
            names = self._layout.reactions.names
            found.append(Impact(time, round(time * 1e9), array, names))
        return found

    def divide(self, parts):
        """Divide every step up to an event into `parts` parts."""
        self.parts = parts
        if self._switching is not None:
            self._switching.parts = parts

    def leave_contacts_out(self):
        """Note no events of contacts from now on: nobody reads them."""
        if self._switching is not None:
            self._switching.touching = None

    def drain_instants(self) -> list[JointInstant]:
        """Return the modes of all joints with stops or friction where one, or the branch of a law, changed.

        They are kept from the first call on. Events of a state that was set before are lost.
        """
        if self._switching is None:
            return []
        instants, self._switching.instants = self._switching.instants or [], []
        return [instant._replace(events=self._named(instant.events)) for instant in instants]
