"""k nearest neighbours: exact, and a new sample costs about the same however many there are."""

from typing import Literal, NamedTuple, Self, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.utils.validation import check_is_fitted

from companion.compiled import kernel
from companion.kernel.parts import Arrays
from companion.regressors.base import Floats
from companion.regressors.checks import checked, checked_samples
from companion.regressors.neighbours import Neighbours
from companion.regressors.online import Answer, OnlineRegressor
from companion.regressors.slots import Keep, SlotMemory, Slots


class KNNModel(NamedTuple):
    """A trained model; ``targets`` (>= n_samples,) by the samples' slots."""

    neighbours: Neighbours
    targets: Floats
    n_samples: int
    k: int

    @overload
    def predict(self, X: ArrayLike, return_std: Literal[False] = False) -> Floats: ...
    @overload
    def predict(self, X: ArrayLike, return_std: Literal[True]) -> tuple[Floats, Floats]: ...
    def predict(self, X: ArrayLike, return_std: bool = False) -> Floats | tuple[Floats, Floats]:
        """Mean of the k nearest targets, and their standard deviation (NaN for one neighbour)."""
        # The kernels are compiled for writable arrays; what is read-only already gets copied.
        queries = np.require(X, np.float32, ("C", "W"))
        index = self.neighbours.nearest(queries, min(self.k, self.n_samples))
        mean, std = _spread(np.require(self.targets, None, "W"), index)
        return (mean, std) if return_std else mean


class KNNRegressor(OnlineRegressor):
    """Mean of the ``n_neighbors`` nearest samples (Euclidean, float32).

    Beyond ``capacity`` those are kept that ``keep`` says (slots.SlotMemory). Learned: ``memory_``,
    ``n_features_in_``.
    """

    def __init__(
        self, n_neighbors: int = 5, capacity: int = 100_000, keep: Keep = "newest"
    ) -> None:
        self.n_neighbors = n_neighbors
        self.capacity = capacity
        self.keep = keep

    def snapshot(self) -> KNNModel:
        """The model as it is now, as a copy."""
        check_is_fitted(self)
        n_kept = self.memory_.n_kept
        targets = self.targets_[:n_kept].copy()
        return KNNModel(self.neighbours_.copy(), targets, n_kept, self.n_neighbors)

    def _learn(self, X: ArrayLike, y: ArrayLike, *, reset: bool) -> Self:
        samples, targets = checked(self, X, y, np.float32, reset=reset)
        if reset:
            self._start(samples.shape[1])
        return self._append(samples, targets)

    def _answer(self, X: ArrayLike) -> Answer:
        """See KNNModel.predict."""
        samples = checked_samples(self, X, np.float32)
        model = KNNModel(self.neighbours_, self.targets_, self.memory_.n_kept, self.n_neighbors)
        mean, std = model.predict(samples, return_std=True)
        return mean, lambda: std

    def _arrays(self) -> Arrays:
        """Samples oldest first: ``X`` (n_samples, n_features), ``y`` (n_samples,).

        An even sample needs to know of how many it is: ``n_seen``.
        """
        order = self.memory_.order()
        rows = self.neighbours_.rows(self.memory_.n_kept)
        arrays: Arrays = {"X": rows[order], "y": self.targets_[order]}
        if self.keep == "mixed":
            arrays["n_seen"] = np.array(self.memory_.n_seen)
        return arrays

    def _take_up(self, state: Arrays) -> None:
        """The newest samples where not all fit."""
        X, y = checked(self, state["X"], state["y"], np.float32, reset=True)
        n_seen = int(np.asarray(state.get("n_seen", len(y)), dtype=np.int64))
        X, y = X[-self.capacity :], y[-self.capacity :]
        self._start(X.shape[1])
        self._put(X, y, self.memory_.restore(max(n_seen, len(y)), len(y)))

    def _start(self, n_features: int) -> None:
        self.neighbours_ = Neighbours(n_features)
        self.targets_ = np.zeros(0)
        self.memory_ = SlotMemory(self.capacity, self.keep)

    def _append(self, X: NDArray[np.float32], y: Floats) -> Self:
        slots = self.memory_.take(len(y))
        if len(y) > 1:
            # What would be overwritten at once need not be written.
            _, from_end = np.unique(slots[::-1], return_index=True)
            last = np.sort(len(y) - 1 - from_end)
            X, y, slots = X[last], y[last], slots[last]
        return self._put(X, y, slots)

    def _put(self, X: NDArray[np.float32], y: Floats, slots: Slots) -> Self:
        self._grow(self.memory_.n_kept)
        self.neighbours_.put(np.require(X, None, "W"), slots)
        self.targets_[slots] = y
        return self

    def _grow(self, n_samples: int) -> None:
        """Room for ``n_samples``, at least doubling, so that growth is O(1) per sample."""
        missing = n_samples - len(self.targets_)
        if missing > 0:
            self.targets_ = np.pad(self.targets_, (0, max(missing, len(self.targets_))))


# The signature is given so that it is compiled, or read from the cache, before take-off.
@kernel("Tuple((f8[::1], f8[::1]))(f8[::1], i8[:,::1])")
def _spread(
    targets: NDArray[np.float64], index: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and sample standard deviation of each row's targets."""
    n_queries, k = index.shape
    mean, std = np.empty(n_queries), np.full(n_queries, np.nan)
    for row in range(n_queries):
        total = 0.0
        for neighbour in index[row]:
            total += targets[neighbour]
        mean[row] = total / k
        scatter = 0.0
        for neighbour in index[row]:
            scatter += (targets[neighbour] - mean[row]) ** 2
        if k > 1:
            std[row] = np.sqrt(scatter / (k - 1))
    return mean, std
