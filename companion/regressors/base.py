"""The contract that every learner of λ keeps: scikit-learn's verbs, plus a snapshot and state."""

from typing import Annotated, Literal, Protocol, Self, overload

import numpy as np
from msgspec import Meta
from numpy.typing import ArrayLike, NDArray

from companion.kernel.parts import Arrays
from companion.kernel.settings import Settings
from companion.regressors.slots import Keep

Floats = NDArray[np.float64]


class RegressorSettings(Settings, frozen=True):
    """What regressors may be told; each reads the fields it knows."""

    k: Annotated[int, Meta(ge=1, le=64)] = 5
    capacity: Annotated[int, Meta(ge=1, le=10_000_000)] = 100_000
    """Samples kept."""
    keep: Keep = "newest"
    """Which they are beyond that: see companion.regressors.slots."""
    seed: Annotated[int, Meta(ge=0)] = 0
    """Of what a regressor draws at random."""


class Predictor(Protocol):
    """An immutable trained model."""

    @overload
    def predict(self, X: ArrayLike, return_std: Literal[False] = False) -> Floats: ...
    @overload
    def predict(self, X: ArrayLike, return_std: Literal[True]) -> tuple[Floats, Floats]: ...
    def predict(self, X: ArrayLike, return_std: bool = False) -> Floats | tuple[Floats, Floats]:
        """Estimates for ``X`` of shape (n, n_features): (n,), and their spread on demand."""
        ...


class Regressor(Predictor, Protocol):
    """A model that goes on learning. Constructors only store parameters."""

    def partial_fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Learns from samples of shape (n, n_features) and targets of shape (n,)."""
        ...

    def snapshot(self) -> Predictor:
        """The model as it is now; later learning does not change it."""
        ...

    def state(self) -> Arrays:
        """All that was learned, as plain arrays; empty before the first sample."""
        ...

    def restore(self, state: Arrays) -> Self:
        """Takes up where ``state`` was taken."""
        ...
