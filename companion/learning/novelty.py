"""Novelty: how unlike everything learned from a frame is, as a figure of its own.

It is the distance to the nearest of some remembered frames, in units of what that distance is
among the remembered frames themselves when those of the same few seconds are left out: below 1
the frame looks like the place where the learner learned, above 1 it has not been there. Features
count in units of their spread there, so that what hardly varies counts for more.
"""

import math
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

Floats32 = NDArray[np.float32]
Arrays = dict[str, NDArray[np.generic]]

CAPACITY = 512
"""Frames remembered, evenly over all that were learned from."""
APART_FRAMES = 64
"""Frames nearer to each other in time show the same view, and tell nothing of the place."""
LEAST_REMEMBERED = 96
"""Before, there is nothing to compare with."""
GROWTH = 1.25
"""The memory is measured anew whenever it has grown by this."""
USUAL_NORM = 0.9
"""Share of the remembered frames whose own novelty is below 1."""
LEAST_SPREAD = 0.1
"""Of the mean spread, added to all: few frames do not tell what never varies."""


class Measured(NamedTuple):
    """Remembered frames, (n, n_features), less ``mean`` and times ``scale``; how far apart."""

    rows: Floats32
    mean: Floats32
    scale: Floats32
    unit: float

    def distance_to(self, features: Floats32) -> float:
        """From the nearest remembered frame."""
        apart = self.rows - (features - self.mean) * self.scale
        return math.sqrt(float(np.einsum("ij,ij->i", apart, apart).min()))


class Novelty:
    """A thinned memory of features, measured now and then."""

    def __init__(self) -> None:
        self._rows: list[Floats32] = []
        self._times: list[int] = []
        self._n_learned = 0
        self._stride = 1
        self._n_measured = 0
        self._measured: Measured | None = None

    def of(self, features: Floats32) -> float:
        """Of a frame with ``features`` (n_features,); NaN until there is a unit."""
        if self._measured is None or not self._measured.unit > 0.0:
            return math.nan
        return self._measured.distance_to(features) / self._measured.unit

    def learn(self, features: Floats32) -> None:
        """Counts a frame in, and remembers every so many."""
        if self._n_learned % self._stride == 0:
            if len(self._times) == CAPACITY:
                self._thin()
            self._rows.append(np.array(features, dtype=np.float32))
            self._times.append(self._n_learned)
            if len(self._times) >= max(LEAST_REMEMBERED, GROWTH * self._n_measured):
                self._measure(len(self._times))
        self._n_learned += 1

    def state(self) -> Arrays:
        """The memory, oldest first: ``rows`` (n, n_features), and when each was learned."""
        if not self._times:
            return {}
        counts = [self._n_learned, self._stride, self._n_measured]
        return {
            "rows": np.array(self._rows),
            "times": np.array(self._times, dtype=np.int64),
            "counts": np.array(counts, dtype=np.int64),
        }

    @classmethod
    def restored(cls, state: Arrays) -> Self:
        """Takes up where ``state`` was taken; starts anew where it is empty."""
        novelty = cls()
        if state:
            novelty._rows = list(np.asarray(state["rows"], dtype=np.float32))
            novelty._times = [int(time) for time in np.asarray(state["times"], dtype=np.int64)]
            counts = (int(count) for count in np.asarray(state["counts"], dtype=np.int64))
            novelty._n_learned, novelty._stride, n_measured = counts
            if n_measured:
                novelty._measure(n_measured)
        return novelty

    def _thin(self) -> None:
        """Forgets every other frame."""
        self._rows, self._times = self._rows[::2], self._times[::2]
        self._stride *= 2
        self._measure(len(self._times))

    def _measure(self, n_frames: int) -> None:
        """By the oldest ``n_frames`` of the memory."""
        rows = np.array(self._rows[:n_frames])
        mean, spread = rows.mean(axis=0), rows.std(axis=0)
        scale = 1.0 / (spread + LEAST_SPREAD * spread.mean() + 1e-9)
        scaled = (rows - mean) * scale
        unit = _usual_distance(scaled, np.array(self._times[:n_frames]))
        self._measured = Measured(scaled, mean, scale, unit)
        self._n_measured = n_frames


def _usual_distance(rows: Floats32, times: NDArray[np.int64]) -> float:
    """That USUAL_NORM of the rows have to the nearest row of another time; NaN without any."""
    lengths = (rows**2).sum(axis=1)
    squared = lengths[:, np.newaxis] + lengths - 2.0 * rows @ rows.T
    squared[np.abs(times[:, np.newaxis] - times) < APART_FRAMES] = np.inf
    nearest = squared.min(axis=1)
    paired = nearest[np.isfinite(nearest)]
    return math.sqrt(max(float(np.quantile(paired, USUAL_NORM)), 0.0)) if len(paired) else math.nan
