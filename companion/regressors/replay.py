"""Networks that learn on while they fly, by replaying a bounded memory of samples.

Each call takes a few steps, so that a frame costs the same at the end of a flight as at its
beginning.
"""

from abc import abstractmethod
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from companion.compiled import kernel
from companion.kernel.parts import Arrays, part
from companion.regressors.base import Floats
from companion.regressors.online import OnlineRegressor
from companion.regressors.scaling import RunningScale
from companion.regressors.slots import Keep, SlotMemory

BINS = 20
"""Targets are drawn from this many ranges, of which the rare ones count for more."""


class ReplayRegressor(OnlineRegressor):
    """Remembers ``capacity`` samples, beyond it those that ``keep`` says (slots.SlotMemory).

    Every call of ``partial_fit`` takes ``n_steps`` steps with ``batch`` of them. Learned:
    ``samples_`` (n, n_features) of type ``STORED`` and ``targets_`` (n,), by slot; ``outputs_``,
    the targets' scale; and what ``_start`` makes.
    """

    STORED: ClassVar[type[np.generic]]
    batch: int
    n_steps: int
    capacity: int
    random_state: int
    keep: Keep = "newest"

    def __sklearn_is_fitted__(self) -> bool:
        return hasattr(self, "memory_")

    def fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Forgets all, then learns ``X`` (n, n_features) and ``y`` (n,) until it settles."""
        self._learn(X, y, reset=True)
        self._train(max(300, 2 * self.memory_.n_seen // self.batch))
        return self

    def partial_fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Remembers the samples and takes ``n_steps`` steps."""
        super().partial_fit(X, y)
        self._train(self.n_steps)
        return self

    def _learn(self, X: ArrayLike, y: ArrayLike, *, reset: bool) -> Self:
        samples, targets = self._checked(X, y, reset=reset)
        if reset:
            self._forget()
        else:
            self._note_error(samples[:1], float(targets[0]))
        self._remember(samples, targets)
        return self

    @abstractmethod
    def _checked(
        self, X: ArrayLike, y: ArrayLike, *, reset: bool
    ) -> tuple[NDArray[np.float32], Floats]:
        """Samples (n, n_features) and targets (n,). Raises ValueError as scikit-learn does."""

    @abstractmethod
    def _start(self) -> None:
        """An untrained network, before the first sample is remembered."""

    @abstractmethod
    def _note_error(self, sample: NDArray[np.float32], target: float) -> None:
        """Of the first sample (1, n_features) of a call, before it is learned from."""

    @abstractmethod
    def _train(self, n_steps: int) -> None:
        """Takes steps with what is remembered."""

    def _forget(self) -> None:
        self.outputs_ = RunningScale(1)
        self.samples_: NDArray[Any] = np.zeros((0, self.n_features_in_), dtype=self.STORED)
        self.targets_: Floats = np.zeros(0)
        self.memory_ = SlotMemory(self.capacity, self.keep, self.random_state)
        self._start()

    def _remember(self, samples: NDArray[np.float32], targets: Floats) -> None:
        self.outputs_.update(targets[:, np.newaxis])
        slots = self.memory_.take(len(targets))
        self._grow(self.memory_.n_kept)
        self.samples_[slots], self.targets_[slots] = self._stored(samples), targets

    def _stored(self, samples: NDArray[np.float32]) -> NDArray[Any]:
        """As they are remembered."""
        return samples.astype(self.STORED)

    def _grow(self, n_samples: int) -> None:
        missing = n_samples - len(self.targets_)
        if missing <= 0:
            return
        extra = min(max(missing, len(self.targets_)), self.capacity - len(self.targets_))
        room = np.zeros((extra, self.n_features_in_), dtype=self.STORED)
        self.samples_ = np.concatenate([self.samples_, room])
        self.targets_ = np.concatenate([self.targets_, np.zeros(extra)])

    def _memory_arrays(self, n_steps: int) -> Arrays:
        """``X`` and ``y``, oldest first; ``counts``: samples seen and steps taken so far."""
        order = self.memory_.order()
        arrays: Arrays = {
            "X": self.samples_[order],
            "y": self.targets_[order],
            "counts": np.array([self.memory_.n_seen, n_steps], dtype=np.int64),
        }
        return arrays | {"order": order} if self.keep == "mixed" else arrays

    def _take_up_memory(self, state: Arrays) -> int:
        """Starts anew with what is remembered, the newest where not all fit; the steps taken."""
        samples = np.asarray(state["X"], dtype=self.STORED)[-self.capacity :]
        self.n_features_in_ = samples.shape[1]
        self._forget()
        n_seen, n_steps = (int(count) for count in state["counts"])
        order = np.asarray(state["order"], dtype=np.int64) if "order" in state else None
        slots = self.memory_.restore(n_seen, len(samples), order)
        self._grow(len(samples))
        self.samples_[slots], self.targets_[slots] = samples, state["y"][-self.capacity :]
        self.outputs_.restore(part(state, "out"))
        return n_steps


@kernel("i8[::1](f8[::1], f8[::1], f8)")
def draw_evenly(
    targets: NDArray[np.float64], draws: NDArray[np.float64], balance: float
) -> NDArray[np.int64]:
    """Rows for ``draws`` in [0, 1): a row weighs the share of rows like it to ``-balance``."""
    least, most = targets.min(), targets.max()
    per_px = (BINS - 1e-6) / max(most - least, 1e-9)
    counts = np.zeros(BINS)
    for target in targets:
        counts[int((target - least) * per_px)] += 1.0
    # As a share of all, with a floor: a single odd sample must not fill every batch.
    weights = (counts / len(targets) + 0.01) ** -balance
    total = np.empty(len(targets))
    running = 0.0
    for row in range(len(targets)):
        running += weights[int((targets[row] - least) * per_px)]
        total[row] = running
    rows = np.searchsorted(total, draws * running, side="right")
    return np.minimum(rows, len(targets) - 1)
