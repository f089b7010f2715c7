"""Features and targets brought to mean 0 and spread 1, and rare targets made to count for more."""

import numpy as np
from numpy.typing import NDArray

from companion.kernel.parts import Arrays
from companion.regressors.base import Floats

LEAST_SPREAD = 1e-6
"""Below it a feature is a constant, and its noise is not blown up."""
LEAST_SHARE = 0.01
"""No target counts as rarer: a single odd sample must not outweigh all others."""


class Rarity:
    """How rare each target is among those seen, in ranges ``WIDTH`` wide."""

    WIDTH = 0.3
    """Of a logarithm of λ: a third more or less is another distance."""
    N_RANGES, LOWEST = 1024, -64
    """Targets beyond are counted at the ends."""

    def __init__(self) -> None:
        self.counts = np.zeros(self.N_RANGES)

    def weights(self, targets: Floats, power: float) -> Floats:
        """Counts the targets (n,) in; their shares of all, to the power of ``-power``: (n,)."""
        ranges = np.floor(targets / self.WIDTH).astype(np.int64) - self.LOWEST
        ranges = np.clip(ranges, 0, self.N_RANGES - 1)
        np.add.at(self.counts, ranges, 1.0)
        shares = self.counts[ranges] / self.counts.sum()
        return np.asarray((shares + LEAST_SHARE) ** -power)


class RunningScale:
    """Mean and standard deviation of rows of ``n_columns``, updated batch by batch (Chan)."""

    def __init__(self, n_columns: int) -> None:
        self.n_rows = 0
        self.mean: Floats = np.zeros(n_columns)
        self._scatter: Floats = np.zeros(n_columns)

    @property
    def scale(self) -> Floats:
        """Standard deviation (n_columns,); 1 where there is none."""
        spread = np.sqrt(self._scatter / max(self.n_rows, 1))
        return np.where(spread > LEAST_SPREAD, spread, 1.0)

    def update(self, rows: NDArray[np.floating]) -> None:
        """Counts ``rows`` (n, n_columns) in."""
        n_new = len(rows)
        mean = rows.mean(axis=0, dtype=np.float64)
        shift = mean - self.mean
        n_all = self.n_rows + n_new
        self._scatter += ((rows - mean) ** 2).sum(axis=0) + shift**2 * (self.n_rows * n_new / n_all)
        self.mean = self.mean + shift * (n_new / n_all)
        self.n_rows = n_all

    def apply(self, rows: NDArray[np.floating]) -> NDArray[np.float32]:
        """Scaled rows, (n, n_columns)."""
        factor = (1.0 / self.scale).astype(np.float32)
        offset = self.mean.astype(np.float32)
        return np.asarray((rows - offset) * factor, dtype=np.float32)

    def state(self) -> Arrays:
        """All that was learned, as plain arrays."""
        mean, scatter = self.mean.copy(), self._scatter.copy()
        return {"n_rows": np.array(self.n_rows), "mean": mean, "scatter": scatter}

    def restore(self, state: Arrays) -> None:
        """Takes up where ``state`` was taken."""
        self.n_rows = int(np.asarray(state["n_rows"], dtype=np.int64))
        self.mean = np.array(state["mean"], dtype=np.float64)
        self._scatter = np.array(state["scatter"], dtype=np.float64)
