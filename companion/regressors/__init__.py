"""Functions from an image's features to its average disparity, chosen by name."""

from collections.abc import Callable, Mapping

from companion.kernel.errors import PlanError
from companion.regressors.base import Predictor, Regressor, RegressorSettings
from companion.regressors.knn import KNNRegressor

__all__ = ["REGRESSORS", "KNNRegressor", "Predictor", "Regressor", "RegressorSettings", "make"]

REGRESSORS: Mapping[str, Callable[[RegressorSettings], Regressor]] = {
    "knn": lambda settings: KNNRegressor(n_neighbors=settings.k, capacity=settings.capacity),
}


def make(name: str, settings: RegressorSettings) -> Regressor:
    """An untrained regressor. Raises PlanError for a name that is not registered."""
    try:
        build = REGRESSORS[name]
    except KeyError:
        allowed = ", ".join(sorted(REGRESSORS))
        raise PlanError(f"regressor: no such regressor {name!r}; allowed: {allowed}") from None
    return build(settings)
