"""Always the mean of what was seen: the floor that every learner must beat."""

from typing import Literal, Self, overload

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils import Tags
from sklearn.utils.validation import check_is_fitted, validate_data

from companion.regressors.base import Arrays, Floats
from companion.regressors.scaling import RunningScale


class MeanRegressor(RegressorMixin, BaseEstimator):  # type: ignore[misc]  # sklearn is untyped
    """Learned: ``targets_``, their running mean and deviation; features are not looked at."""

    def fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Forgets all, then learns ``X`` (n, n_features) and ``y`` (n,)."""
        return self._learn(X, y, reset=True)

    def partial_fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Adds samples."""
        return self._learn(X, y, reset=not hasattr(self, "targets_"))

    @overload
    def predict(self, X: ArrayLike, return_std: Literal[False] = False) -> Floats: ...
    @overload
    def predict(self, X: ArrayLike, return_std: Literal[True]) -> tuple[Floats, Floats]: ...
    def predict(self, X: ArrayLike, return_std: bool = False) -> Floats | tuple[Floats, Floats]:
        """The same mean (n,) and deviation for every row."""
        check_is_fitted(self)
        n_rows = len(validate_data(self, X, reset=False))
        mean = np.full(n_rows, self.targets_.mean[0])
        return (mean, np.full(n_rows, self.targets_.scale[0])) if return_std else mean

    def snapshot(self) -> Self:
        """The model as it is now; it shares nothing with this one."""
        check_is_fitted(self)
        return type(self)().restore(self.state())

    def state(self) -> Arrays:
        """The running mean, and how many features there were."""
        if not hasattr(self, "targets_"):
            return {}
        return self.targets_.state() | {"n_features": np.array(self.n_features_in_)}

    def restore(self, state: Arrays) -> Self:
        """Takes up where ``state`` was taken."""
        if state:
            self.n_features_in_ = int(np.asarray(state["n_features"], dtype=np.int64))
            self.targets_ = RunningScale(1)
            self.targets_.restore(state)
        return self

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.regressor_tags.poor_score = True
        return tags

    def _learn(self, X: ArrayLike, y: ArrayLike, *, reset: bool) -> Self:
        _, targets = validate_data(self, X, y, y_numeric=True, reset=reset)
        if reset:
            self.targets_ = RunningScale(1)
        self.targets_.update(np.asarray(targets, dtype=np.float64)[:, np.newaxis])
        return self
