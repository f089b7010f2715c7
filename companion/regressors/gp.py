"""Gaussian process over a window of the newest samples: bounded work however long the flight."""

from copy import copy
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve
from sklearn.utils.validation import check_is_fitted, validate_data

from companion.kernel.parts import Arrays
from companion.regressors.base import Floats
from companion.regressors.online import Answer, OnlineRegressor


class GPRegressor(OnlineRegressor):
    """Squared-exponential kernel on scaled features, of ``length`` times the root of their number.

    The newest ``window`` samples are known, older ones forgotten; ``noise`` is the targets' own
    spread, as a share of their deviation.
    """

    def __init__(self, window: int = 400, length: float = 1.0, noise: float = 0.3) -> None:
        self.window = window
        self.length = length
        self.noise = noise

    def snapshot(self) -> Self:
        """The model as it is now; it shares nothing with this one."""
        check_is_fitted(self)
        return copy(self)  # whatever changes is replaced

    def _learn(self, X: ArrayLike, y: ArrayLike, *, reset: bool) -> Self:
        samples, targets = validate_data(self, X, y, dtype=np.float64, y_numeric=True, reset=reset)
        if not reset:
            samples = np.concatenate([self.samples_, samples])
            targets = np.concatenate([self.targets_, targets])
        self.samples_: Floats = samples[-self.window :]
        self.targets_: Floats = targets[-self.window :]
        self._solve()
        return self

    def _answer(self, X: ArrayLike) -> Answer:
        """Mean and deviation of the posterior, with the targets' own noise."""
        samples = validate_data(self, X, dtype=np.float64, reset=False)
        near = self._kernel((samples - self.mean_) / self.scale_)
        mean = near @ self.weights_ * self.target_scale_ + self.target_mean_

        def spread() -> Floats:
            explained = np.einsum("ij,ji->i", near, cho_solve(self.factor_, near.T))
            variance = np.maximum(1.0 - explained, 0.0) + self.noise**2
            return np.asarray(self.target_scale_ * np.sqrt(variance))

        return np.asarray(mean), spread

    def _arrays(self) -> Arrays:
        """The window's samples, oldest first: ``X`` (n, n_features), ``y`` (n,)."""
        return {"X": self.samples_.copy(), "y": self.targets_.copy()}

    def _take_up(self, state: Arrays) -> None:
        self.fit(state["X"], state["y"])

    def _solve(self) -> None:
        """The window's weights."""
        spread = self.samples_.std(axis=0)
        self.mean_ = self.samples_.mean(axis=0)
        self.scale_ = np.where(spread > 1e-9, spread, 1.0)
        self.target_mean_ = self.targets_.mean()
        self.target_scale_ = self.targets_.std() or 1.0
        self.inputs_ = (self.samples_ - self.mean_) / self.scale_
        known = self._kernel(self.inputs_) + self.noise**2 * np.eye(len(self.inputs_))
        self.factor_ = cho_factor(known, lower=True)
        wanted = (self.targets_ - self.target_mean_) / self.target_scale_
        self.weights_ = cho_solve(self.factor_, wanted)

    def _kernel(self, inputs: Floats) -> Floats:
        """Of every row with every sample of the window: (n, n_window)."""
        squared = (inputs**2).sum(axis=1)[:, np.newaxis] + (self.inputs_**2).sum(axis=1)
        squared -= 2.0 * inputs @ self.inputs_.T
        unit = 2.0 * self.length**2 * self.n_features_in_
        return np.asarray(np.exp(-np.maximum(squared, 0.0) / unit))
