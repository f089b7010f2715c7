"""Ridge regression from running sums: exact whatever the order, and no sample is kept."""

from copy import copy
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_factor, cho_solve
from sklearn.utils.validation import check_is_fitted

from companion.kernel.parts import Arrays
from companion.regressors.base import Floats
from companion.regressors.checks import checked, checked_samples
from companion.regressors.online import Answer, OnlineRegressor
from companion.regressors.scaling import Rarity


class RidgeRegressor(OnlineRegressor):
    """Least squares on scaled features with a penalty of ``alpha`` samples' worth.

    The weights are solved for anew whenever the samples have grown by the share ``refresh``. With
    ``balance``, a sample counts by the share of samples with such a target to its negative power.
    Learned: ``moments_``, the sums of products of rows (1, features, target), (n + 2, n + 2).
    """

    def __init__(self, alpha: float = 1.0, refresh: float = 0.0, balance: float = 0.0) -> None:
        self.alpha = alpha
        self.refresh = refresh
        self.balance = balance

    def snapshot(self) -> Self:
        """The model as it is now; it shares nothing with this one."""
        check_is_fitted(self)
        twin = copy(self)  # all but the sums is replaced when it changes
        twin.moments_ = self.moments_.copy()
        return twin

    def _learn(self, X: ArrayLike, y: ArrayLike, *, reset: bool) -> Self:
        samples, targets = checked(self, X, y, np.float64, reset=reset)
        if reset:
            size = self.n_features_in_ + 2
            self.moments_ = np.zeros((size, size))
            self.rarity_ = Rarity()
        rows = np.column_stack([np.ones(len(samples)), samples, targets])
        if self.balance:
            weights = self.rarity_.weights(targets, self.balance)
            self.moments_ += (rows * weights[:, np.newaxis]).T @ rows
        else:
            self.moments_ += rows.T @ rows
        if reset or self.moments_[0, 0] > (1.0 + self.refresh) * self.solved_moments_[0, 0]:
            self._solve()
        return self

    def _answer(self, X: ArrayLike) -> Answer:
        """Spread: of the residuals, and of the weights far from what was seen."""
        samples = checked_samples(self, X, np.float64)
        centred = (samples - self.mean_) / self.scale_
        mean = centred @ self.weights_ + self.target_mean_

        def spread() -> Floats:
            reach = np.einsum("ij,ji->i", centred, cho_solve(self.factor_, centred.T))
            share = 1.0 / self.moments_[0, 0]
            return np.asarray(np.sqrt(self.variance_ * (1.0 + share + reach)))

        return np.asarray(mean), spread

    def _arrays(self) -> Arrays:
        """The sums now, and those that the weights are of."""
        return {
            "moments": self.moments_.copy(),
            "solved": self.solved_moments_.copy(),
            "counts": self.rarity_.counts.copy(),
        }

    def _take_up(self, state: Arrays) -> None:
        self.n_features_in_ = len(state["moments"]) - 2
        self.moments_ = np.array(state["solved"], dtype=np.float64)
        self._solve()
        self.moments_ = np.array(state["moments"], dtype=np.float64)
        self.rarity_ = Rarity()
        self.rarity_.counts = np.array(state["counts"], dtype=np.float64)

    def _solve(self) -> None:
        """Weights from the sums."""
        n_seen = self.moments_[0, 0]
        mean = self.moments_[0, 1:] / n_seen
        scatter = self.moments_[1:, 1:] - n_seen * np.outer(mean, mean)
        spread = np.sqrt(np.maximum(np.diag(scatter)[:-1], 0.0) / n_seen)
        self.mean_, self.target_mean_ = mean[:-1], mean[-1]
        # What is left of a constant feature after the subtraction above is rounding, not spread.
        varies = spread > 1e-9 + 1e-6 * np.abs(mean[:-1])
        self.scale_: NDArray[np.float64] = np.where(varies, spread, 1.0)
        products = scatter[:-1, :-1] / np.outer(self.scale_, self.scale_)
        self.factor_ = cho_factor(products + self.alpha * np.eye(len(products)), lower=True)
        towards = scatter[:-1, -1] / self.scale_
        self.weights_ = cho_solve(self.factor_, towards)
        self.variance_ = max(float(scatter[-1, -1] - towards @ self.weights_), 0.0) / n_seen
        self.solved_moments_ = self.moments_.copy()
