"""Gaussian process over a window of the newest samples: bounded work however long the flight."""

from copy import copy
from typing import Literal, Self, overload

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from companion.regressors.base import Arrays, Floats


class GPRegressor(RegressorMixin, BaseEstimator):  # type: ignore[misc]  # sklearn is untyped
    """Squared-exponential kernel on scaled features, of ``length`` times the root of their number.

    The newest ``window`` samples are known; ``noise`` is the targets' own spread, as a share of
    their deviation.
    """

    def __init__(self, window: int = 400, length: float = 1.0, noise: float = 0.3) -> None:
        self.window = window
        self.length = length
        self.noise = noise

    def fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Forgets all, then learns ``X`` (n, n_features) and ``y`` (n,)."""
        return self._learn(X, y, reset=True)

    def partial_fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Adds samples; beyond ``window`` the oldest are forgotten."""
        return self._learn(X, y, reset=not hasattr(self, "samples_"))

    @overload
    def predict(self, X: ArrayLike, return_std: Literal[False] = False) -> Floats: ...
    @overload
    def predict(self, X: ArrayLike, return_std: Literal[True]) -> tuple[Floats, Floats]: ...
    def predict(self, X: ArrayLike, return_std: bool = False) -> Floats | tuple[Floats, Floats]:
        """Mean (n,) and standard deviation of the posterior, with the targets' own noise."""
        check_is_fitted(self)
        samples = validate_data(self, X, dtype=np.float64, reset=False)
        near = self._kernel((samples - self.mean_) / self.scale_)
        mean = near @ self.weights_ * self.target_scale_ + self.target_mean_
        if not return_std:
            return np.asarray(mean)
        explained = np.einsum("ij,ji->i", near, cho_solve(self.factor_, near.T))
        variance = np.maximum(1.0 - explained, 0.0) + self.noise**2
        return np.asarray(mean), self.target_scale_ * np.sqrt(variance)

    def snapshot(self) -> Self:
        """The model as it is now; it shares nothing with this one."""
        check_is_fitted(self)
        return copy(self)  # whatever changes is replaced

    def state(self) -> Arrays:
        """The window's samples, oldest first: ``X`` (n, n_features), ``y`` (n,)."""
        if not hasattr(self, "samples_"):
            return {}
        return {"X": self.samples_.copy(), "y": self.targets_.copy()}

    def restore(self, state: Arrays) -> Self:
        """Learns the samples of ``state`` afresh."""
        return self.fit(state["X"], state["y"]) if state else self

    def _learn(self, X: ArrayLike, y: ArrayLike, *, reset: bool) -> Self:
        samples, targets = validate_data(self, X, y, dtype=np.float64, y_numeric=True, reset=reset)
        if not reset:
            state = self.state()
            samples = np.concatenate([state["X"], samples])
            targets = np.concatenate([state["y"], targets])
        self.samples_, self.targets_ = samples[-self.window :], targets[-self.window :]
        self._solve()
        return self

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
