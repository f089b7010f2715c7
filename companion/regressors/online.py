"""What all regressors do alike: scikit-learn's verbs around how each of them learns and answers."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Literal, Self, overload

from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils.validation import check_is_fitted

from companion.kernel.parts import Arrays
from companion.regressors.base import Floats, Predictor

Answer = tuple[Floats, Callable[[], Floats]]
"""Means (n,), and what works their spread (n,) out: that costs more, and is not always wanted."""


class OnlineRegressor(RegressorMixin, BaseEstimator, ABC):  # type: ignore[misc]  # sklearn is untyped
    """A regressor that learns batch by batch, from nothing or from where ``state`` was taken."""

    def __sklearn_is_fitted__(self) -> bool:
        return hasattr(self, "n_features_in_")

    def fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Forgets all, then learns ``X`` (n, n_features) and ``y`` (n,)."""
        return self._learn(X, y, reset=True)

    def partial_fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Learns further samples."""
        return self._learn(X, y, reset=not self.__sklearn_is_fitted__())

    @overload
    def predict(self, X: ArrayLike, return_std: Literal[False] = False) -> Floats: ...
    @overload
    def predict(self, X: ArrayLike, return_std: Literal[True]) -> tuple[Floats, Floats]: ...
    def predict(self, X: ArrayLike, return_std: bool = False) -> Floats | tuple[Floats, Floats]:
        """Estimates (n,), and their spread on demand. Raises NotFittedError before any sample."""
        if not self.__sklearn_is_fitted__():  # asked first: scikit-learn's own check is slow
            check_is_fitted(self)
        mean, spread = self._answer(X)
        return (mean, spread()) if return_std else mean

    def snapshot(self) -> Predictor:
        """The model as it is now; it shares nothing that changes with this one."""
        check_is_fitted(self)
        return type(self)(**self.get_params()).restore(self.state())

    def state(self) -> Arrays:
        """All that was learned, as plain arrays; empty before the first sample."""
        return self._arrays() if self.__sklearn_is_fitted__() else {}

    def restore(self, state: Arrays) -> Self:
        """Takes up where ``state`` was taken; learning goes on to the same bits."""
        if state:
            self._take_up(state)
        return self

    @abstractmethod
    def _learn(self, X: ArrayLike, y: ArrayLike, *, reset: bool) -> Self:
        """From samples that are yet to be checked; with ``reset`` from these alone."""

    @abstractmethod
    def _answer(self, X: ArrayLike) -> Answer:
        """Of a trained model, to samples that are yet to be checked."""

    @abstractmethod
    def _arrays(self) -> Arrays:
        """Of a trained model: its ``state``, which shares nothing with it."""

    @abstractmethod
    def _take_up(self, state: Arrays) -> None:
        """What ``_arrays`` gave."""
