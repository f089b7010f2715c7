"""Small neural networks that learn on while they fly, from a bounded memory of samples.

Several networks with two hidden layers start from different weights and see different draws of
the memory; their mean is the estimate, and where they disagree nothing like it was learned. Each
call takes a few steps, so that a frame costs the same at the end of a flight as at its beginning.
"""

from copy import copy, deepcopy
from typing import Literal, Self, overload

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from companion.regressors.base import Arrays, Floats
from companion.regressors.network import Network, Tensor
from companion.regressors.scaling import RunningScale
from companion.regressors.slots import Keep, SlotMemory, Slots

BINS = 20
"""Targets are drawn from this many ranges, of which the rare ones count for more."""
RESIDUAL_RATE = 0.01
"""Weight of the newest error in the running mean of squared errors."""


class MLPRegressor(RegressorMixin, BaseEstimator):  # type: ignore[misc]  # sklearn is untyped
    """Mean of ``n_networks`` networks trained by replay; ``predict`` gives their spread too.

    ``capacity`` samples are remembered, beyond it those that ``keep`` says (slots.SlotMemory);
    every call of ``partial_fit`` takes ``n_steps`` steps with ``batch`` of them per network.
    """

    def __init__(
        self,
        hidden: tuple[int, int] = (64, 32),
        n_networks: int = 3,
        batch: int = 32,
        n_steps: int = 2,
        capacity: int = 20_000,
        balance: float = 0.5,
        random_state: int = 0,
        keep: Keep = "newest",
    ) -> None:
        self.hidden = hidden
        self.n_networks = n_networks
        self.batch = batch
        self.n_steps = n_steps
        self.capacity = capacity
        self.balance = balance
        self.random_state = random_state
        self.keep = keep

    def fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Forgets all, then learns ``X`` (n, n_features) and ``y`` (n,) until it settles."""
        samples, targets = validate_data(
            self, X, y, dtype=np.float32, order="C", y_numeric=True, reset=True
        )
        self._start()._remember(samples, np.asarray(targets, dtype=np.float64))
        for _ in range(max(300, 2 * len(targets) // self.batch)):
            self._train(1)
        return self

    def partial_fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Remembers the samples and takes ``n_steps`` steps."""
        first = not hasattr(self, "network_")
        samples, targets = validate_data(
            self, X, y, dtype=np.float32, order="C", y_numeric=True, reset=first
        )
        if first:
            self._start()
        targets = np.asarray(targets, dtype=np.float64)
        if not first:
            self._note_error(samples[0], float(targets[0]))
        self._remember(samples, targets)
        self._train(self.n_steps)
        return self

    @overload
    def predict(self, X: ArrayLike, return_std: Literal[False] = False) -> Floats: ...
    @overload
    def predict(self, X: ArrayLike, return_std: Literal[True]) -> tuple[Floats, Floats]: ...
    def predict(self, X: ArrayLike, return_std: bool = False) -> Floats | tuple[Floats, Floats]:
        """Mean (n,); spread: the networks' disagreement and the usual error of new samples."""
        check_is_fitted(self)
        samples = validate_data(self, X, dtype=np.float32, order="C", reset=False)
        answers = self.network_.answer(self.inputs_.apply(samples))
        mean = answers.mean(axis=0) * self.outputs_.scale[0] + self.outputs_.mean[0]
        if not return_std:
            return np.asarray(mean, dtype=np.float64)
        variance = answers.var(axis=0, ddof=min(1, self.n_networks - 1)) * self.outputs_.scale**2
        return np.asarray(mean, dtype=np.float64), np.sqrt(variance + self.error_)

    def snapshot(self) -> Self:
        """The model as it is now; it only predicts, and shares nothing that changes."""
        check_is_fitted(self)
        twin = copy(self)
        twin.network_, twin.inputs_, twin.outputs_ = deepcopy(
            (self.network_, self.inputs_, self.outputs_)
        )
        return twin

    def state(self) -> Arrays:
        """Memory oldest first, scales, weights and the optimiser's moments."""
        if not hasattr(self, "network_"):
            return {}
        order = self.memory_.order()
        arrays: Arrays = {
            "X": self.samples_[order],
            "y": self.targets_[order],
            "counts": np.array([self.memory_.n_seen, self.network_.n_steps], dtype=np.int64),
            "error": np.array(self.error_),
        }
        if self.keep == "mixed":
            arrays["order"] = order
        for prefix, part in (("in", self.inputs_), ("out", self.outputs_)):
            arrays |= {f"{prefix}.{name}": values for name, values in part.state().items()}
        return arrays | self.network_.state()

    def restore(self, state: Arrays) -> Self:
        """Takes up where ``state`` was taken; learning goes on to the same bits."""
        if not state:
            return self
        samples = np.asarray(state["X"], dtype=np.float16)[-self.capacity :]
        self.n_features_in_ = samples.shape[1]
        self._start()
        n_seen, n_steps = (int(count) for count in state["counts"])
        slots = self.memory_.restore(n_seen, len(samples), _slots_in(state))
        self._grow(len(samples))
        self.samples_[slots], self.targets_[slots] = samples, state["y"][-self.capacity :]
        self.error_ = float(np.asarray(state["error"], dtype=np.float64))
        for prefix, part in (("in.", self.inputs_), ("out.", self.outputs_)):
            part.restore(
                {n.removeprefix(prefix): v for n, v in state.items() if n.startswith(prefix)}
            )
        self.network_.restore(state, n_steps)
        return self

    def _start(self) -> Self:
        n_features = self.n_features_in_
        rng = np.random.default_rng(self.random_state)
        self.network_ = Network((n_features, *self.hidden, 1), self.n_networks, rng)
        self.inputs_, self.outputs_ = RunningScale(n_features), RunningScale(1)
        # Half precision halves the saved model; features are measured far less precisely.
        self.samples_ = np.zeros((0, n_features), dtype=np.float16)
        self.targets_ = np.zeros(0)
        self.memory_ = SlotMemory(self.capacity, self.keep, self.random_state)
        self.error_ = 0.0
        return self

    def _note_error(self, sample: NDArray[np.float32], target: float) -> None:
        """Of the first sample of a call, before it is learned from."""
        squared = (float(self.predict(sample[np.newaxis])[0]) - target) ** 2
        self.error_ += RESIDUAL_RATE * (squared - self.error_)

    def _remember(self, samples: NDArray[np.float32], targets: Floats) -> None:
        self.inputs_.update(samples)
        self.outputs_.update(targets[:, np.newaxis])
        slots = self.memory_.take(len(targets))
        self._grow(self.memory_.n_kept)
        self.samples_[slots], self.targets_[slots] = samples, targets

    def _grow(self, n_samples: int) -> None:
        missing = n_samples - len(self.targets_)
        if missing <= 0:
            return
        extra = min(max(missing, len(self.targets_)), self.capacity - len(self.targets_))
        room = np.zeros((extra, self.n_features_in_), dtype=np.float16)
        self.samples_ = np.concatenate([self.samples_, room])
        self.targets_ = np.concatenate([self.targets_, np.zeros(extra)])

    def _train(self, n_steps: int) -> None:
        n_kept = self.memory_.n_kept
        for _ in range(n_steps):
            # A generator per step: a restored model goes on as the original would.
            rng = np.random.default_rng([self.random_state, self.network_.n_steps])
            draws = rng.random(self.n_networks * self.batch)
            chosen = draw_evenly(self.targets_[:n_kept], draws, self.balance)
            inputs = self.inputs_.apply(self.samples_[chosen].astype(np.float32))
            wanted = self.outputs_.apply(self.targets_[chosen, np.newaxis])[:, 0]
            shape = (self.n_networks, self.batch)
            batch: Tensor = inputs.reshape(*shape, -1)
            self.network_.step(batch, wanted.reshape(shape), rng)


def _slots_in(state: Arrays) -> Slots | None:
    return np.asarray(state["order"], dtype=np.int64) if "order" in state else None


@njit("i8[::1](f8[::1], f8[::1], f8)", cache=True, nogil=True)
def draw_evenly(targets, draws, balance):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201 - numba finds the types
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
