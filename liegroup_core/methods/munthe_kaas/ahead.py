# SPDX-License-Identifier: Apache-2.0
"""Substeps as long as the motion allows: the integration runs ahead, and the states between are interpolated.

The state of the links in RelativeWork, the lead, is at most one substep ahead of the caller's time. There the state is

    Psi(theta) = h sum_j b_j(theta) k_j ,   X(theta) = X_0 exp Psi(theta)

with the derivatives k_j of the stages, of the end, and of three further stages that are evaluated only if somebody
asks for a state inside the substep. In the algebra a substep is one of a Runge-Kutta method for
Psi' = dexp^-1_{-Psi} F, so this has the order of its interpolant: 7 for the 8(5,3) pair (Hairer, Norsett and Wanner,
Solving ODEs I, II.6). `radau5` has its collocation polynomial, of order 3. Joints of the tree stay closed, loops are
projected. Orders, and errors below their estimates: test/core/test_states_inside.py.

The rows of Scheme.a after that of the end are the further stages, and last b(theta). Substeps end at known changes
of the inputs. If inputs change elsewhere, the integration goes back to the caller's state. So a run depends on its
inputs, and not on the times at which states are asked for. Times are whole steps and seconds after them, so that
differences are exact at late times, too.

A substep with an event of a stop or of friction is repeated as one that ends before it, at the end of a step. The
events of a step are found in that step alone (events/switching.py), and the lead goes on from its end.
"""

import contextlib
import math

import numpy as np
import scipy

from liegroup_core.compiling import kernel
from liegroup_core.forces.acting import Acting
from liegroup_core.forces.instants import NOT_AHEAD
from liegroup_core.mechanism.arrays import COORDINATE
from liegroup_core.mechanism.bodies import copy_state

from .error_control import DIVIDED

SAME_TIME = 1e-14  # relative to a step, round-off: a substep that ends so close to the end of a step ends there


class Lead:
    """The lead of a method: whether there is one, and where it starts.

    work, control : of the method

    grid, limit : StepGrid, and Instant of the next known change of the inputs
    acting : Acting, for which it is the lead
    """

    grid = limit = None

    def __init__(self, work, control):
        self._work, self._control = work, control
        self.acting = Acting(work.lead_external, work.lead_targets, work.lead_motions)

    @property
    def runs(self):
        """Whether the integration runs ahead."""
        return self._control.ahead[0] != 0.0

    @property
    def known(self):
        """Whether there is a lead, else it starts at the caller's state."""
        return self._control.leads[0] != 0.0

    @property
    def time(self):
        """(whole steps, s after them), or NOT_AHEAD."""
        control = self._control
        if control.leads[0] == 0.0 or control.ahead[0] == 0.0:
            return NOT_AHEAD
        return control.base.item(), control.lead.item()

    def go_back(self):
        """Continue from the caller's state."""
        self._work.known[0] = 0.0
        self._end()

    @contextlib.contextmanager
    def left(self):
        """Step by step, from the lead on, which has become the caller's state; then there is no lead."""
        self._control.ahead[0] = 0.0
        try:
            yield
        finally:
            self._control.ahead[0] = 1.0
            self._end()

    def _end(self):
        """There is no lead, and nothing is kept: equal states have equal snapshots."""
        self.forget()
        self._control.part_of("base", "due")[:] = 0.0

    def forget(self):
        """Forget the kept substep."""
        work, control = self._work, self._control
        for array in (work.kept_pose, work.kept_twist, work.kept_slopes, work.kept_angle, work.kept_coordinates):
            array[:] = 0.0
        for number in (control.kept_base, control.kept_lead, control.last):
            number[0] = 0.0

    def call(self, begin, end):
        """Set the whole steps at which a call begins and ends."""
        clock, control = self._work.clock, self._control
        if begin != clock.from_step[0] and control.next_base[0] < math.inf:
            control.next_after[0] = self.grid.between(self.grid.boundary(int(begin)), self.limit)
        clock.from_step[0], clock.to_step[0], clock.until[0] = begin, end, 0.0


def polynomials():
    """Weights (16, 7) of theta, theta^2, ... in the b_j of the 8(5,3) pair, from SciPy's nested form."""
    dop853 = scipy.integrate.DOP853
    stages, unit = len(dop853.B), np.eye(16)
    end = np.zeros(16)
    end[:stages] = dop853.B
    rows = [end, unit[0] - end, 2.0 * end - unit[0] - unit[stages], *dop853.D]
    total = np.zeros((16, 1))
    for k in range(len(rows) - 1, -1, -1):
        total[:, 0] += rows[k]
        grown = np.zeros((16, total.shape[1] + 1))
        grown[:, k % 2 == 0 :][:, : total.shape[1]] = total
        if k % 2 == 1:
            grown[:, 1:] -= total
        total = grown
    return np.ascontiguousarray(total[:, 1:])


def further_stages():
    """(rows (3, 16) of the tableau, their nodes) of the three further stages of the 8(5,3) pair."""
    return scipy.integrate.DOP853.A_EXTRA, scipy.integrate.DOP853.C_EXTRA


@kernel
def _rows_differ(present, lead):
    """Whether two arrays (k, c) differ; `lead` becomes the present one."""
    differs = False
    for i in range(len(present)):
        for c in range(present.shape[1]):
            differs = differs or present[i, c] != lead[i, c]
            lead[i, c] = present[i, c]
    return differs


@kernel
def meet_inputs(work, external, control):
    """Keep the inputs; if they change, go back to the caller's state."""
    differs = _rows_differ(external, work.lead_external)
    differs = _rows_differ(work.targets, work.lead_targets) or differs
    differs = _rows_differ(work.motions, work.lead_motions) or differs
    if differs:
        work.known[0] = control.leads[0] = 0.0


@kernel
def between(base, since, other_base, other, step):
    """Time in s from one time to another, both whole steps and s after them."""
    return (other_base - base) * step + (other - since)


@kernel
def start_lead(work, control):
    """Start at the caller's time."""
    control.base[0], control.lead[0], control.fresh[0] = work.clock.from_step[0], work.clock.since[0], 0.0
    control.limit_base[0], control.limit[0] = control.next_base[0], control.next[0]
    control.left[0] = control.next_after[0]
    control.begins[0] = control.leads[0] = control.shared[0] = 1.0
    control.seen[0] = control.due[0] = 0.0


@kernel
def meet_limit(work, control):
    """Take over the next known change of the inputs."""
    base, limit = control.next_base[0], control.next[0]
    if base != control.limit_base[0] or limit != control.limit[0]:
        control.limit_base[0], control.limit[0] = base, limit
        control.left[0] = between(control.base[0], control.lead[0], base, limit, work.clock.step_size[0])


@kernel
def time_left(work, control):
    """Time in s from the lead to the end of the call."""
    clock = work.clock
    return between(control.base[0], control.lead[0], clock.to_step[0], clock.until[0], clock.step_size[0])


@kernel
def time_before(work, control):
    """Time in s from the start of the call to the lead."""
    clock = work.clock
    return between(clock.from_step[0], clock.since[0], control.base[0], control.lead[0], clock.step_size[0])


@kernel
def fraction(work, control):
    """The end of the call as a fraction of the kept substep."""
    clock, begin = work.clock, control.kept_base[0]
    return between(begin, control.kept_lead[0], clock.to_step[0], clock.until[0], clock.step_size[0]) / control.last[0]


@kernel
def time_of(base, since, step):
    """Time in s."""
    return base * step + since


@kernel
def passes(work, control, size, at_limit):
    """Whether a substep from the lead on ends the call, or passes the end of a step."""
    base, clock, step = control.base[0], work.clock, work.clock.step_size[0]
    after, lead = base, control.lead[0] + size
    if at_limit:
        after, lead = control.limit_base[0], control.limit[0]
    elif lead >= step * (1.0 - SAME_TIME):
        return True
    return after > base or between(after, lead, clock.to_step[0], clock.until[0], step) <= 0.0


@kernel
def shorten(work, control, size, at_limit, place):
    """Whether a substep with an event goes on beyond the step of the lead; then it is to be repeated with another size.

    at_limit : whether it ends at a known change, whose time has no round-off of the sizes before
    place    : fraction of the substep at which the event is expected, below 1
    """
    step, lead = work.clock.step_size[0], control.lead[0]
    control.seen[0] = size
    end = (control.limit_base[0] - control.base[0]) * step + control.limit[0] if at_limit else lead + size
    if end <= step * (1.0 + SAME_TIME):
        control.due[0] = 1.0
        return False
    control.size[0] = max(1.0, math.floor((lead + place * size) / step)) * step - lead
    if divides(control):
        control.size[0] *= DIVIDED
    return True


@kernel
def divides(control):
    """Whether a companion is to divide a substep that ends where that of the simulation does."""
    return control.coarse[0] != 0.0 and control.shared[0] != 0.0


@kernel
def go_on(work, control, size, at_limit):
    """Move the time of the lead by a substep."""
    control.left[0] -= size
    control.shared[0] = 1.0 if at_limit else 0.0
    before = control.base[0]
    if at_limit:
        control.base[0], control.lead[0] = control.limit_base[0], control.limit[0]
    else:
        lead, step = control.lead[0] + size, work.clock.step_size[0]
        near = SAME_TIME * max(lead, step) if control.seen[0] > 0.0 else 0.0
        whole = math.floor((lead + near) / step)
        control.base[0] += whole
        control.lead[0] = lead - whole * step if lead - whole * step > near else 0.0
    if control.base[0] != before:
        control.begins[0] = 1.0
    control.seen[0] = max(0.0, control.seen[0] - size)
    if 0.0 < control.seen[0] < control.size[0]:
        control.size[0] = control.seen[0]


@kernel
def keep_turns(work, angles, coordinates):
    """Keep the unwrapped angles and the coordinates of switches."""
    for i in range(len(angles)):
        angles[i] = work.angle[i]
    for k in range(len(coordinates)):
        coordinates[k] = work.modes[k, COORDINATE]


@kernel
def set_turns(work, angles, coordinates):
    """Return to kept angles and coordinates of switches."""
    for i in range(len(angles)):
        work.angle[i] = angles[i]
    for k in range(len(coordinates)):
        work.modes[k, COORDINATE] = coordinates[k]


@kernel
def _copy_slopes(source, out, count):
    """Copy the first `count` rows of derivatives."""
    for r in range(count):
        out[r, 0], out[r, 1] = source[r, 0], source[r, 1]


@kernel
def keep(work, pose, twist, size, control):
    """Keep the substep that begins at the lead, without its stages: its start."""
    copy_state(pose, twist, work.kept_pose, work.kept_twist)
    keep_turns(work, work.kept_angle, work.kept_coordinates)
    control.kept_base[0], control.kept_lead[0] = control.base[0], control.lead[0]
    control.last[0], control.ready[0] = size, 0.0


@kernel
def keep_slopes(work):
    """Keep the derivatives of all stages."""
    _copy_slopes(work.slopes, work.kept_slopes, len(work.slopes))


@kernel
def recall(work):
    """Return to the derivatives of the kept substep."""
    _copy_slopes(work.kept_slopes, work.slopes, len(work.slopes))


@kernel
def keep_lead(work, control):
    """Keep the derivative at the lead."""
    _copy_slopes(work.slopes, work.lead_slopes, len(work.lead_slopes))
    control.fresh[0] = 1.0


@kernel
def recall_lead(work):
    """Return to the derivative at the lead."""
    _copy_slopes(work.lead_slopes, work.slopes, len(work.lead_slopes))


@kernel
def set_weights(scheme, theta):
    """Set the last row of Scheme.a to b(theta)."""
    last = len(scheme.a) - 1
    scheme.nodes[last] = theta
    for j in range(len(scheme.inside)):
        total = 0.0
        for d in range(scheme.inside.shape[1] - 1, -1, -1):
            total = theta * (total + scheme.inside[j, d])
        scheme.a[last, j] = total
