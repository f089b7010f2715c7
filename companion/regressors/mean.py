"""Always the mean of what was seen: the floor that every learner must beat."""

from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.utils import Tags
from sklearn.utils.validation import validate_data

from companion.kernel.parts import Arrays
from companion.regressors.online import Answer, OnlineRegressor
from companion.regressors.scaling import RunningScale


class MeanRegressor(OnlineRegressor):
    """The same mean and deviation for every row; features are not looked at.

    Learned: ``targets_``, the running mean and deviation.
    """

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

    def _answer(self, X: ArrayLike) -> Answer:
        n_rows = len(validate_data(self, X, reset=False))
        mean = np.full(n_rows, self.targets_.mean[0])
        return mean, lambda: np.full(n_rows, self.targets_.scale[0])

    def _arrays(self) -> Arrays:
        """The running mean, and how many features there were."""
        return self.targets_.state() | {"n_features": np.array(self.n_features_in_)}

    def _take_up(self, state: Arrays) -> None:
        self.n_features_in_ = int(np.asarray(state["n_features"], dtype=np.int64))
        self.targets_ = RunningScale(1)
        self.targets_.restore(state)
