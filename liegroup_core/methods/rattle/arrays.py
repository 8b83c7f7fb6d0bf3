# SPDX-License-Identifier: Apache-2.0
"""Memory of a RATTLE step."""

import numpy as np

from liegroup_core.compiling import Struct, kernel, shaped
from liegroup_core.mechanism.arrays import PlaneModel

# Velocity-dependent forces are iterated until no rate changes by more than TOLERANCE times the
# largest one. If round-off is larger: until changes below STUCK times that stop decreasing.
TOLERANCE, STUCK = 1e-15, 100.0
MAX_REPEATS = 100
# Corrections that Broyden's method stores before it restarts.
HISTORY = 8
LONGER = 10.0  # times the last substep: for a longer substep the growth is not extrapolated


class RattleMemory(Struct):
    """Memory of the method besides the state and the work; bias, growth and size are for initial guesses.

    Wrenches and momenta have s numbers: 6, in a plane 3.
    """

    centre: np.ndarray  # (L, 3) centre of mass in the link, m
    central: np.ndarray  # (L, 6) inertia about it: xx, xy, xz, yy, yz, zz
    weight: np.ndarray = shaped("links", 3)  # acceleration of gravity, link axes
    load: np.ndarray = shaped("links", "twist")  # Q at the start of a substep, then at its end; about the origin
    last_load: np.ndarray = shaped("links", "twist")  # that of the last iteration
    impulse: np.ndarray = shaped("links", "twist")  # M V + (h/2) Q, then M V'+ + (h/2) Q+, about the origin
    half: np.ndarray = shaped("links", "twist")  # M V' about the centre of mass, axes of the start
    # Displacement of each link in a substep, axes of the start: unit quaternion (real part first), m, bound
    # of the angle. In a plane: angle, cos - 1, sin, m
    moves: np.ndarray = shaped("links", 8)
    world: np.ndarray = shaped("links", 12)  # poses at the end of a substep; of links at cut joints
    psi: np.ndarray = shaped("freedoms", 1)  # displacements of the joints in a substep
    corrections: np.ndarray = shaped(HISTORY, "freedoms")  # of psi, then of the rates, in this substep
    residual: np.ndarray = shaped("freedoms")  # of the rates at the end
    bias: np.ndarray = shaped("freedoms")  # (2/h) (psi/h - qdot) of the last substep
    growth: np.ndarray = shaped("freedoms")  # time derivative of `bias`
    size: np.ndarray = shaped(1)  # s, the last substep; 0: none yet
    turned: np.ndarray = shaped(1)  # rad^2, largest squared rotation of a link in a substep


def make_memory(model):
    """Allocate a RattleMemory of a RelativeModel."""
    links = model.links
    mass = np.where(links["mass"] > 0.0, links["mass"], 1.0)[:, None]
    centre = links["moment"] / mass
    moment = np.einsum("bi,bj->bij", links["moment"], centre)
    shift = np.einsum("bii->b", moment)[:, None, None] * np.eye(3) - moment
    rows, columns = np.triu_indices(3)
    central = np.ascontiguousarray(links["inertia"] - shift[:, rows, columns])
    twist = 3 if isinstance(model, PlaneModel) else 6
    sizes = dict(links=len(links), freedoms=int(links["freedoms"].sum()), twist=twist)
    return RattleMemory.zeros(sizes, centre=np.ascontiguousarray(centre), central=central)


@kernel
def times_between(memory, h):
    """Times in s between the points at h/3 of the last substep and of this one, for initial guesses.

    returns (this time, the time over which `growth` is extrapolated). The latter is 0 after a substep that a
    change of wrenches has cut short, because its growth is that of the change, or round-off
    """
    since = (2.0 * memory.size[0] + h) / 3.0
    return since, since if abs(h) <= LONGER * abs(memory.size[0]) else 0.0


def clear_guesses(memory):
    """Clear the initial guesses: the state was set."""
    for guess in (memory.bias, memory.growth, memory.size):
        guess[:] = 0.0
