"""By which side cloth leaves a box that it is found inside of: each patch of it by one side, as a whole.

The nearest side differs from vertex to vertex. Cloth that a box appears across would be pushed to all its
sides at once, which is along the cloth, where it does not give way; so it would stay, and tremble. The side
by which the deepest vertex of a patch has the shortest way is the same for all of the patch, and the farther
that it is on this way the more surely it is chosen again.
"""

from __future__ import annotations

import numpy as np

from sim.contact.contacts import Contacts, groups
from sim.contact.obstacles import ROUNDED, Poses, Shapes


def leave_together(
    contacts: Contacts,
    shapes: Shapes,
    before: Poses,
    after: Poses,
    positions: np.ndarray,
    edges: np.ndarray,
    h: float,
) -> Contacts:
    """The same contacts of vertices with obstacles, where those inside a box leave it by their patch's side.

    Args:
        contacts: As `sim.contact.detect.detect` finds them.
        shapes: That they are with.
        before: Where these are at the start of the step.
        after: And at its end.
        positions: (n, 3) of vertices at the start [m].
        edges: (e, 2) of the cloth; a patch is what they join, of vertices inside one box.
        h: Length of the step [s].
    """
    obstacle = contacts.key % len(shapes.kind)
    box = (shapes.kind[obstacle] == ROUNDED) & (shapes.radius[obstacle] == 0.0)
    inside = np.flatnonzero(box & (contacts.start < 0.0))
    if len(inside) < 2:  # one alone leaves by the nearest side
        return contacts
    contacts = Contacts(*(array.copy() for array in contacts))
    for o in np.unique(obstacle[inside]):
        mine = inside[obstacle[inside] == o]
        vertex, half = contacts.node[mine, 0], shapes.half[o]
        local = (positions[vertex] - before.position[o]) @ before.rotation[o]
        ways = np.stack([half - local, half + local])  # (2, k, 3) to the sides where axes end and begin
        place = np.full(len(positions), -1)
        place[vertex] = np.arange(len(mine))
        patch = groups(len(mine), place[edges[(place[edges] >= 0).all(axis=1)]])
        for p in np.unique(patch):
            which = np.flatnonzero(patch == p)
            end, axis = divmod(int(ways[:, which].max(axis=1).argmin()), 3)
            sign, c = 1.0 - 2.0 * end, mine[which]
            side = local[which].copy()
            side[:, axis] = sign * half[axis]
            normal = sign * after.rotation[o][:, axis]
            was, now = (side @ poses.rotation[o].T + poses.position[o] for poses in (before, after))
            contacts.normal[c], contacts.speed[c] = normal, (now - was) / h
            contacts.offset[c] = normal @ after.position[o] + half[axis]
            contacts.start[c] = -ways[end, which, axis]
    return contacts
