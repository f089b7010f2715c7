"""Novelty: how unlike everything learned from a frame is, as a figure of its own.

It is the distance to the nearest of some remembered frames, in units of what that distance is
among the remembered frames themselves when those of the same few seconds are left out: below 1
the frame looks like the place where the learner learned, well above 1 it has not been there.
"""

import math
from typing import Self

import numpy as np
from numba import njit
from numpy.typing import NDArray

from companion.kernel.fastmath import FASTMATH

Floats32 = NDArray[np.float32]
Arrays = dict[str, NDArray[np.generic]]

CAPACITY = 512
"""Frames remembered, evenly over all that were learned from."""
APART_FRAMES = 64
"""Frames nearer to each other in time show the same view, and tell nothing of the place."""
LEAST_PAIRED = 32
"""Frames that need a partner of another time before there is a unit."""
USUAL_NORM = 0.99
"""Share of the remembered frames whose own novelty is below 1."""


class Novelty:
    """A thinned memory of features, and the distances within it."""

    def __init__(self) -> None:
        self._rows: Floats32 = np.empty((0, CAPACITY), dtype=np.float32)
        """(n_features, CAPACITY): frames side by side, so that distances fill vector registers."""
        self._times = np.empty(0, dtype=np.int64)
        self._nearest_apart: Floats32 = np.empty(0, dtype=np.float32)
        self._n_learned = 0
        self._stride = 1
        self._unit = math.nan

    def of(self, features: Floats32) -> float:
        """Of a frame with ``features`` (n_features,); NaN until there is a unit."""
        if math.isnan(self._unit):
            return math.nan
        return math.sqrt(float(self._squared_to(features).min())) / self._unit

    def learn(self, features: Floats32) -> None:
        """Counts a frame in, and remembers every so many."""
        if self._n_learned % self._stride == 0:
            if len(self._times) == CAPACITY:
                self._thin()
            self._remember(features, self._n_learned)
            self._measure_unit()
        self._n_learned += 1

    def state(self) -> Arrays:
        """The memory, oldest first: ``rows`` (n, n_features), and when each was learned."""
        if not len(self._times):
            return {}
        counts = np.array([self._n_learned, self._stride], dtype=np.int64)
        rows = self._rows[:, : len(self._times)].T.copy()
        return {"rows": rows, "times": self._times.copy(), "counts": counts}

    @classmethod
    def restored(cls, state: Arrays) -> Self:
        """Takes up where ``state`` was taken; starts anew where it is empty.

        Raises ValueError for a stride that leads nowhere.
        """
        novelty = cls()
        if state:
            counts = np.asarray(state["counts"], dtype=np.int64)
            novelty._n_learned, novelty._stride = int(counts[0]), int(counts[1])
            if novelty._stride < 1:
                raise ValueError(f"a stride of {novelty._stride} frames")
            rows = np.asarray(state["rows"], dtype=np.float32)
            for row, time in zip(rows, np.asarray(state["times"], dtype=np.int64), strict=True):
                novelty._remember(row, int(time))
            novelty._measure_unit()
        return novelty

    def _remember(self, features: Floats32, time: int) -> None:
        if not len(self._times):
            self._rows = np.zeros((len(features), CAPACITY), dtype=np.float32)
        squared = self._squared_to(features)
        squared[time - self._times < APART_FRAMES] = np.inf
        self._nearest_apart = np.append(
            np.minimum(self._nearest_apart, squared), squared.min(initial=np.inf)
        )
        self._rows[:, len(self._times)] = features
        self._times = np.append(self._times, time)

    def _thin(self) -> None:
        """Forgets every other frame."""
        rows, times = self._rows[:, ::2].T.copy(), self._times[::2]
        self._times, self._nearest_apart = self._times[:0], self._nearest_apart[:0]
        self._stride *= 2
        for row, time in zip(rows, times, strict=True):
            self._remember(row, int(time))

    def _measure_unit(self) -> None:
        paired = self._nearest_apart[np.isfinite(self._nearest_apart)]
        if len(paired) >= LEAST_PAIRED:
            place = min(int(USUAL_NORM * len(paired)), len(paired) - 1)
            self._unit = math.sqrt(float(np.partition(paired, place)[place])) or math.nan

    def _squared_to(self, features: Floats32) -> Floats32:
        """Squared distance to each remembered frame, (n,)."""
        squared = np.empty(len(self._times), dtype=np.float32)
        _squared(self._rows, np.ascontiguousarray(features), squared)
        return squared


# The signature is given so that it is compiled, or read from the cache, before take-off.
@njit("void(f4[:,::1], f4[::1], f4[::1])", cache=True, nogil=True, fastmath=FASTMATH)
def _squared(rows, query, squared):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202 - numba finds the types
    squared[:] = 0.0
    for feature in range(len(rows)):
        value = query[feature]
        for place in range(len(squared)):
            difference = rows[feature, place] - value
            squared[place] += difference * difference
