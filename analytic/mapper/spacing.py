"""How far the representatives of nodes are from each other ([I] 4.5), kept from one question to the next.

The mean distance among all nodes asks for every pair, but between two questions only few representatives move. The
distances are kept in a table, and only the rows of those that moved are computed. A representative is known by the
array that it is, which never changes; so the table holds true for whichever state of the map asks, a draft that is
given up and a map that was loaded among them. Where in the table a distance stands has no effect on its value. A copy
of a table, for a copy of a map or for another process, starts empty: there, the arrays are others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Place = Sequence[NDArray[np.float64]]  # the representatives (D,) of one node, one for each mode

_ROOM = 32  # rows of a first table
_GROWTH = 1.5


class Spacing:
    """A table of the distances between representatives."""

    def __init__(self) -> None:
        self._slots: dict[int, int] = {}  # from the identity of an array to its row
        self._known: list[NDArray[np.float64] | None] = []  # holds on to the arrays, so that no identity is used twice
        self._centres = np.empty((0, 0))
        self._apart = np.empty((0, 0))

    def __reduce__(self) -> tuple[type[Spacing], tuple[()]]:
        """Return how copies are made: empty, since the identities of arrays are not those of their copies."""
        return Spacing, ()

    def among(self, places: Sequence[Place]) -> float:
        """Return the mean distance between places, each pair by its nearest representatives; 0 for fewer than 2."""
        if len(places) < 2:
            return 0.0
        slots = self._refreshed([centre for place in places for centre in place])
        apart = self._apart[np.ix_(slots, slots)]
        if len(slots) > len(places):
            starts = _starts(places)[:-1]
            apart = np.minimum.reduceat(np.minimum.reduceat(apart, starts, axis=0), starts, axis=1)
        return float(np.mean(apart[np.triu(np.ones(apart.shape, dtype=bool), 1)]))

    def _refreshed(self, centres: list[NDArray[np.float64]]) -> list[int]:
        """Return the rows of representatives, after computing those that are not known."""
        wanted = {id(centre) for centre in centres}
        free = [slot for slot, known in enumerate(self._known) if known is None or id(known) not in wanted]
        for centre in centres:
            if id(centre) not in self._slots:
                self._put(free.pop() if free else self._grown(len(centre)), centre)
        return [self._slots[id(centre)] for centre in centres]

    def _put(self, slot: int, centre: NDArray[np.float64]) -> None:
        # A row counts as unknown until it is whole, since an interrupted one may not be used again.
        gone, self._known[slot] = self._known[slot], None
        self._slots.pop(id(gone), None)
        self._centres[slot] = centre
        used = len(self._known)
        self._apart[slot, :used] = self._apart[:used, slot] = distances(centre, self._centres[:used])
        self._known[slot] = centre
        self._slots[id(centre)] = slot

    def _grown(self, size: int) -> int:
        """Return a row more than there were."""
        slot, room = len(self._known), len(self._apart)
        if slot == room:
            room = max(_ROOM, int(_GROWTH * room))
            centres, apart = np.zeros((room, size)), np.zeros((room, room))
            if slot:
                centres[:slot], apart[:slot, :slot] = self._centres, self._apart
            self._centres, self._apart = centres, apart
        self._known.append(None)
        return slot


def mean_distance(point: NDArray[np.float64], places: Sequence[Place]) -> float:
    """Return the mean Euclidean distance of a point (D,) to places, each the nearest of its representatives."""
    apart = distances(point, np.array([centre for place in places for centre in place]))
    return float(np.mean(np.minimum.reduceat(apart, _starts(places)[:-1])))


def distances(point: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the Euclidean distances (n,) of a point (D,) to others (n, D)."""
    # One by one, so that a value does not depend on which others there are.
    return np.sqrt([away.dot(away) for away in others - point])


def _starts(places: Sequence[Place]) -> NDArray[np.int64]:
    return np.cumsum([0, *(len(place) for place in places)])
