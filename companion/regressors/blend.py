"""The mean of two regressors that err differently: a stiff one and a supple one."""

from typing import Literal, NamedTuple, Self, overload

import numpy as np
from numpy.typing import ArrayLike

from companion.kernel.parts import Arrays, part, whole
from companion.regressors.base import Floats, Predictor, Regressor


class BlendModel(NamedTuple):
    """Trained members; see BlendRegressor."""

    members: tuple[Predictor, ...]

    @overload
    def predict(self, X: ArrayLike, return_std: Literal[False] = False) -> Floats: ...
    @overload
    def predict(self, X: ArrayLike, return_std: Literal[True]) -> tuple[Floats, Floats]: ...
    def predict(self, X: ArrayLike, return_std: bool = False) -> Floats | tuple[Floats, Floats]:
        """Mean of the members' means (n,); spread: theirs, and where they disagree."""
        if not return_std:
            return np.asarray(np.mean([member.predict(X) for member in self.members], axis=0))
        answers = [member.predict(X, return_std=True) for member in self.members]
        means = np.array([mean for mean, _ in answers])
        own_variance = np.mean([std**2 for _, std in answers], axis=0)
        return means.mean(axis=0), np.sqrt(own_variance + means.var(axis=0))


class BlendRegressor:
    """Members learn the same samples side by side; they are named by their place."""

    def __init__(self, *members: Regressor) -> None:
        self.members = members

    @overload
    def predict(self, X: ArrayLike, return_std: Literal[False] = False) -> Floats: ...
    @overload
    def predict(self, X: ArrayLike, return_std: Literal[True]) -> tuple[Floats, Floats]: ...
    def predict(self, X: ArrayLike, return_std: bool = False) -> Floats | tuple[Floats, Floats]:
        """See BlendModel.predict."""
        model = BlendModel(self.members)
        return model.predict(X, return_std=True) if return_std else model.predict(X)

    def partial_fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Every member learns the samples."""
        for member in self.members:
            member.partial_fit(X, y)
        return self

    def snapshot(self) -> BlendModel:
        """The members as they are now."""
        return BlendModel(tuple(member.snapshot() for member in self.members))

    def state(self) -> Arrays:
        """The members' arrays, each name after the member's place."""
        return whole(**{str(n): member.state() for n, member in enumerate(self.members)})

    def restore(self, state: Arrays) -> Self:
        """Takes up where ``state`` was taken."""
        for place, member in enumerate(self.members):
            member.restore(part(state, str(place)))
        return self
