"""Functions from an image's features to its average disparity, chosen by name."""

from collections.abc import Callable, Mapping

from companion.kernel.errors import PlanError
from companion.regressors.base import Predictor, Regressor, RegressorSettings
from companion.regressors.blend import BlendRegressor
from companion.regressors.gp import GPRegressor
from companion.regressors.knn import KNNRegressor
from companion.regressors.mean import MeanRegressor
from companion.regressors.mlp import MLPRegressor
from companion.regressors.ridge import RidgeRegressor

__all__ = [
    "REGRESSORS",
    "BlendRegressor",
    "GPRegressor",
    "KNNRegressor",
    "MLPRegressor",
    "MeanRegressor",
    "Predictor",
    "Regressor",
    "RegressorSettings",
    "RidgeRegressor",
    "make",
]

MLP_CAPACITY = 20_000
"""Samples that a network replays: enough for a flight, and 10 MB of gradients."""
CNN_CAPACITY = 10_000
"""Shrunk images that a convolutional network replays: 30 MB."""
BLEND_ALPHA, BLEND_REFRESH = 600.0, 0.02
"""Strong penalty: many features, neighbouring frames alike. Solving for each would take 1 ms."""
BLEND_BALANCE = 0.5
"""Near frames are few and matter most; balanced fully, the many would be estimated poorly."""


def _networks(settings: RegressorSettings, n_networks: int) -> MLPRegressor:
    capacity = min(settings.capacity, MLP_CAPACITY)
    return MLPRegressor(
        n_networks=n_networks,
        capacity=capacity,
        random_state=settings.seed,
        keep=settings.keep,
    )


def _blend(settings: RegressorSettings) -> BlendRegressor:
    ridge = RidgeRegressor(alpha=BLEND_ALPHA, refresh=BLEND_REFRESH, balance=BLEND_BALANCE)
    networks = _networks(settings, n_networks=2).set_params(n_steps=1, balance=1.0)
    return BlendRegressor(ridge, networks)


def _convolutional(settings: RegressorSettings) -> Regressor:
    try:
        from companion.regressors.cnn import CNNRegressor
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise PlanError(
            'learner.regressor: "cnn" needs PyTorch, which is not installed; the extra "deep" '
            "brings it: pip install -c constraints.txt -e .[deep]"
        ) from None
    capacity = min(settings.capacity, CNN_CAPACITY)
    return CNNRegressor(capacity=capacity, random_state=settings.seed)


REGRESSORS: Mapping[str, Callable[[RegressorSettings], Regressor]] = {
    "blend": _blend,
    "cnn": _convolutional,
    "gp": lambda settings: GPRegressor(window=min(GPRegressor().window, settings.capacity)),
    "knn": lambda settings: KNNRegressor(
        n_neighbors=settings.k, capacity=settings.capacity, keep=settings.keep
    ),
    "mean": lambda settings: MeanRegressor(),
    "mlp": lambda settings: _networks(settings, n_networks=3),
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
