"""Functions from an image's features to its average disparity, chosen by name."""

from collections.abc import Callable, Mapping

from companion.kernel.errors import PlanError
from companion.regressors.base import Predictor, Regressor, RegressorSettings
from companion.regressors.blend import BlendRegressor
from companion.regressors.gp import GPRegressor
from companion.regressors.knn import KNNRegressor
from companion.regressors.mlp import MLPRegressor
from companion.regressors.ridge import RidgeRegressor

__all__ = [
    "REGRESSORS",
    "BlendRegressor",
    "GPRegressor",
    "KNNRegressor",
    "MLPRegressor",
    "Predictor",
    "Regressor",
    "RegressorSettings",
    "RidgeRegressor",
    "make",
]

MLP_CAPACITY = 20_000
"""Samples that a network replays: enough for a flight, and 10 MB of gradients."""
BLEND_ALPHA, BLEND_REFRESH = 600.0, 0.02
"""Strong penalty: many features, neighbouring frames alike. Solving for each would take 1 ms."""
BLEND_BALANCE = 0.5
"""Near frames are few and matter most; balanced fully, the many would be estimated poorly."""


def _networks(settings: RegressorSettings, n_networks: int, n_steps: int) -> MLPRegressor:
    capacity = min(settings.capacity, MLP_CAPACITY)
    return MLPRegressor(
        n_networks=n_networks, n_steps=n_steps, capacity=capacity, random_state=settings.seed
    )


def _blend(settings: RegressorSettings) -> BlendRegressor:
    ridge = RidgeRegressor(alpha=BLEND_ALPHA, refresh=BLEND_REFRESH, balance=BLEND_BALANCE)
    return BlendRegressor(ridge, _networks(settings, n_networks=2, n_steps=1))


REGRESSORS: Mapping[str, Callable[[RegressorSettings], Regressor]] = {
    "blend": _blend,
    "gp": lambda settings: GPRegressor(window=min(GPRegressor().window, settings.capacity)),
    "knn": lambda settings: KNNRegressor(n_neighbors=settings.k, capacity=settings.capacity),
    "mlp": lambda settings: _networks(settings, n_networks=3, n_steps=2),
    "ridge": lambda settings: RidgeRegressor(),
}


def make(name: str, settings: RegressorSettings) -> Regressor:
    """An untrained regressor. Raises PlanError for a name that is not registered."""
    try:
        build = REGRESSORS[name]
    except KeyError:
        allowed = ", ".join(sorted(REGRESSORS))
        raise PlanError(f"regressor: no such regressor {name!r}; allowed: {allowed}") from None
    return build(settings)
