"""Small neural networks trained by replay.

Several networks with two hidden layers start from different weights and see different draws of
the memory; their mean is the estimate, and where they disagree nothing like it was learned.
"""

from copy import copy, deepcopy
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.utils.validation import check_is_fitted

from companion.kernel.parts import Arrays, part, whole
from companion.regressors.base import Floats
from companion.regressors.checks import checked, checked_samples
from companion.regressors.network import Network, Tensor
from companion.regressors.online import Answer
from companion.regressors.replay import ReplayRegressor, draw_evenly
from companion.regressors.scaling import RunningScale
from companion.regressors.slots import Keep

RESIDUAL_RATE = 0.01
"""Weight of the newest error in the running mean of squared errors."""


class MLPRegressor(ReplayRegressor):
    """Mean of ``n_networks`` networks; ``predict`` gives their spread too.

    Every step takes ``batch`` samples per network. Learned: ``network_``, ``inputs_``, the
    features' scale, and ``error_``.
    """

    # Half precision halves the saved model; features are measured far less precisely.
    STORED = np.float16

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

    def snapshot(self) -> Self:
        """The model as it is now; it only predicts, and shares nothing that changes."""
        check_is_fitted(self)
        twin = copy(self)
        twin.network_, twin.inputs_, twin.outputs_ = deepcopy(
            (self.network_, self.inputs_, self.outputs_)
        )
        return twin

    def _checked(
        self, X: ArrayLike, y: ArrayLike, *, reset: bool
    ) -> tuple[NDArray[np.float32], Floats]:
        return checked(self, X, y, np.float32, reset=reset)

    def _answer(self, X: ArrayLike) -> Answer:
        """Spread: the networks' disagreement and the usual error of new samples."""
        samples = checked_samples(self, X, np.float32)
        answers = self.network_.answer(self.inputs_.apply(samples))
        mean = answers.mean(axis=0) * self.outputs_.scale[0] + self.outputs_.mean[0]

        def spread() -> Floats:
            own = answers.var(axis=0, ddof=min(1, self.n_networks - 1)) * self.outputs_.scale**2
            return np.asarray(np.sqrt(own + self.error_))

        return np.asarray(mean, dtype=np.float64), spread

    def _arrays(self) -> Arrays:
        """Memory, scales, weights and the optimiser's moments."""
        arrays = self._memory_arrays(self.network_.n_steps) | {"error": np.array(self.error_)}
        scales = whole(**{"in": self.inputs_.state(), "out": self.outputs_.state()})
        return arrays | scales | self.network_.state()

    def _take_up(self, state: Arrays) -> None:
        n_steps = self._take_up_memory(state)
        self.error_ = float(np.asarray(state["error"], dtype=np.float64))
        self.inputs_.restore(part(state, "in"))
        self.network_.restore(state, n_steps)

    def _start(self) -> None:
        n_features = self.n_features_in_
        rng = np.random.default_rng(self.random_state)
        self.network_ = Network((n_features, *self.hidden, 1), self.n_networks, rng)
        self.inputs_ = RunningScale(n_features)
        self.error_ = 0.0

    def _note_error(self, sample: NDArray[np.float32], target: float) -> None:
        squared = (float(self.predict(sample)[0]) - target) ** 2
        self.error_ += RESIDUAL_RATE * (squared - self.error_)

    def _remember(self, samples: NDArray[np.float32], targets: Floats) -> None:
        self.inputs_.update(samples)
        super()._remember(samples, targets)

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
