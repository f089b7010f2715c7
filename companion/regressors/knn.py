"""k nearest neighbours: exact, and a new sample costs the same however many there are.

Samples lie in tiles of shape (n_features, TILE), so that the distance loop runs across samples
in the processor's vector registers and needs no index to be rebuilt.
"""

from typing import Literal, NamedTuple, Self, overload

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from companion.kernel.fastmath import FASTMATH
from companion.regressors.base import Arrays, Floats
from companion.regressors.slots import Keep, SlotMemory, Slots

TILE = 128
"""Samples per tile: one tile of 21 features is 10 kB, a third of a first-level cache."""


class KNNModel(NamedTuple):
    """A trained model; ``tiles`` (n_tiles, n_features, TILE), ``targets`` (n_tiles * TILE,)."""

    tiles: NDArray[np.float32]
    targets: Floats
    n_samples: int
    k: int

    @overload
    def predict(self, X: ArrayLike, return_std: Literal[False] = False) -> Floats: ...
    @overload
    def predict(self, X: ArrayLike, return_std: Literal[True]) -> tuple[Floats, Floats]: ...
    def predict(self, X: ArrayLike, return_std: bool = False) -> Floats | tuple[Floats, Floats]:
        """Mean of the k nearest targets, and their standard deviation (NaN for one neighbour)."""
        # The kernel is compiled for writable arrays; what is read-only already gets copied.
        queries = np.require(X, np.float32, ("C", "W"))
        tiles, targets = np.require(self.tiles, None, "W"), np.require(self.targets, None, "W")
        mean, std = _query(tiles, targets, self.n_samples, self.k, queries)
        return (mean, std) if return_std else mean


class KNNRegressor(RegressorMixin, BaseEstimator):  # type: ignore[misc]  # sklearn is untyped
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

    def fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Forgets all, then learns ``X`` (n, n_features) and ``y`` (n,)."""
        X, y = self._validated(X, y, reset=True)
        return self._start(X.shape[1])._append(X, y)

    def partial_fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Adds samples."""
        first = not hasattr(self, "tiles_")
        X, y = self._validated(X, y, reset=first)
        if first:
            self._start(X.shape[1])
        return self._append(X, y)

    @overload
    def predict(self, X: ArrayLike, return_std: Literal[False] = False) -> Floats: ...
    @overload
    def predict(self, X: ArrayLike, return_std: Literal[True]) -> tuple[Floats, Floats]: ...
    def predict(self, X: ArrayLike, return_std: bool = False) -> Floats | tuple[Floats, Floats]:
        """See KNNModel.predict. Raises NotFittedError before the first sample."""
        if not hasattr(self, "tiles_"):
            check_is_fitted(self)
        if not self._is_plain(X):
            X = validate_data(self, X, dtype=np.float32, order="C", reset=False)
        model = KNNModel(self.tiles_, self.targets_, self.memory_.n_kept, self.n_neighbors)
        return model.predict(X, return_std=True) if return_std else model.predict(X)

    def snapshot(self) -> KNNModel:
        """The model as it is now, as a copy."""
        check_is_fitted(self)
        used = -(-self.memory_.n_kept // TILE)
        return KNNModel(
            tiles=self.tiles_[:used].copy(),
            targets=self.targets_[: used * TILE].copy(),
            n_samples=self.memory_.n_kept,
            k=self.n_neighbors,
        )

    def state(self) -> Arrays:
        """Samples oldest first: ``X`` (n_samples, n_features), ``y`` (n_samples,).

        An even sample needs to know of how many it is: ``n_seen``.
        """
        if not hasattr(self, "tiles_"):
            return {}
        rows = self.tiles_.transpose(0, 2, 1).reshape(-1, self.n_features_in_)
        order = self.memory_.order()
        arrays: Arrays = {"X": rows[order], "y": self.targets_[order]}
        if self.keep == "mixed":
            arrays["n_seen"] = np.array(self.memory_.n_seen)
        return arrays

    def restore(self, state: Arrays) -> Self:
        """Takes up where ``state`` was taken."""
        if not state:
            return self
        X, y = self._validated(state["X"], state["y"], reset=True)
        n_seen = int(np.asarray(state.get("n_seen", len(y)), dtype=np.int64))
        self._start(X.shape[1])
        X, y = X[-self.capacity :], y[-self.capacity :]
        return self._put(X, y, self.memory_.restore(max(n_seen, len(y)), len(y)))

    def _validated(
        self, X: ArrayLike, y: ArrayLike, *, reset: bool
    ) -> tuple[NDArray[np.float32], Floats]:
        if not reset and self._is_plain(X) and self._are_plain_targets(y):
            return X, y  # type: ignore[return-value]  # just checked
        samples, targets = validate_data(
            self, X, y, dtype=np.float32, order="C", y_numeric=True, reset=reset
        )
        return samples, np.ascontiguousarray(targets, dtype=np.float64)

    def _is_plain(self, X: ArrayLike) -> bool:
        """True for what flies: scikit-learn's own check would cost more than the search."""
        return (
            type(X) is np.ndarray
            and X.dtype == np.float32
            and X.ndim == 2
            and X.flags.c_contiguous
            and X.shape[1] == self.n_features_in_
            and X.shape[0] > 0
            and bool(np.isfinite(X).all())
        )

    @staticmethod
    def _are_plain_targets(y: ArrayLike) -> bool:
        return (
            type(y) is np.ndarray
            and y.dtype == np.float64
            and y.shape == (1,)
            and bool(np.isfinite(y).all())
        )

    def _start(self, n_features: int) -> Self:
        self.tiles_ = np.zeros((0, n_features, TILE), dtype=np.float32)
        self.targets_ = np.zeros(0)
        self.memory_ = SlotMemory(self.capacity, self.keep)
        return self

    def _append(self, X: NDArray[np.float32], y: Floats) -> Self:
        return self._put(X, y, self.memory_.take(len(y)))

    def _put(self, X: NDArray[np.float32], y: Floats, slots: Slots) -> Self:
        self._grow(self.memory_.n_kept)
        self.tiles_[slots // TILE, :, slots % TILE] = X
        self.targets_[slots] = y
        return self

    def _grow(self, n_samples: int) -> None:
        """Room for ``n_samples``, at least doubling, so that growth is O(1) per sample."""
        n_tiles = -(-n_samples // TILE)
        missing = n_tiles - len(self.tiles_)
        if missing <= 0:
            return
        n_limit = -(-self.capacity // TILE)
        extra = min(max(missing, len(self.tiles_)), n_limit - len(self.tiles_))
        room = np.zeros((extra, *self.tiles_.shape[1:]), dtype=np.float32)
        self.tiles_ = np.concatenate([self.tiles_, room])
        self.targets_ = np.concatenate([self.targets_, np.zeros(extra * TILE)])


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def _distances(tile, query, distance):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202 - numba finds the types
    """Squared distance of every sample in the tile."""
    distance[:] = 0.0
    for feature in range(len(query)):
        value = query[feature]
        for sample in range(TILE):
            difference = tile[feature, sample] - value
            distance[sample] += difference * difference


@njit(cache=True, nogil=True)
def _keep_nearest(distance, n_valid, tile, nearest, index):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202 - numba finds the types
    """Insertion into the sorted list of the nearest; of equals, the lower slot stays."""
    last = len(nearest) - 1
    for sample in range(n_valid):
        candidate = distance[sample]
        if candidate < nearest[last]:
            place = last
            while place > 0 and nearest[place - 1] > candidate:
                nearest[place] = nearest[place - 1]
                index[place] = index[place - 1]
                place -= 1
            nearest[place] = candidate
            index[place] = tile * TILE + sample


@njit(cache=True, nogil=True)
def _spread(targets, index):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202 - numba finds the types
    total = 0.0
    for neighbour in index:
        total += targets[neighbour]
    mean = total / len(index)
    scatter = 0.0
    for neighbour in index:
        scatter += (targets[neighbour] - mean) ** 2
    std = np.sqrt(scatter / (len(index) - 1)) if len(index) > 1 else np.nan
    return mean, std


# Signatures are given so that kernels are compiled, or read from the cache, before take-off.
@njit("Tuple((f8[::1], f8[::1]))(f4[:,:,::1], f8[::1], i8, i8, f4[:,::1])", cache=True, nogil=True)
def _query(tiles, targets, n_samples, k, queries):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202 - numba finds the types
    """Mean and sample standard deviation of the k nearest targets for each row of queries."""
    n_queries = len(queries)
    k = min(k, n_samples)
    mean = np.empty(n_queries)
    std = np.empty(n_queries)
    distance = np.empty(TILE, dtype=np.float32)
    nearest = np.empty(k, dtype=np.float32)
    index = np.empty(k, dtype=np.int64)
    for row in range(n_queries):
        nearest[:] = np.inf
        index[:] = 0
        for tile in range((n_samples + TILE - 1) // TILE):
            _distances(tiles[tile], queries[row], distance)
            _keep_nearest(distance, min(TILE, n_samples - tile * TILE), tile, nearest, index)
        mean[row], std[row] = _spread(targets, index)
    return mean, std
