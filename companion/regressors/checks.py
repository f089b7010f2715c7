"""scikit-learn's checks of samples, but for what flies: there they cost more than the learning."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator
from sklearn.utils.validation import validate_data

from companion.regressors.base import Floats


def checked(
    model: BaseEstimator, X: ArrayLike, y: ArrayLike, dtype: type[np.floating[Any]], *, reset: bool
) -> tuple[NDArray[Any], Floats]:
    """Samples (n, n_features) of ``dtype`` and targets (n,). Raises ValueError as scikit-learn."""
    if not reset and _is_plain(model, X) and _are_plain_targets(X, y):
        return np.asarray(X, dtype=dtype), np.asarray(y)
    samples, targets = validate_data(
        model, X, y, dtype=dtype, order="C", y_numeric=True, reset=reset
    )
    return samples, np.asarray(targets, dtype=np.float64)


def checked_samples(
    model: BaseEstimator, X: ArrayLike, dtype: type[np.floating[Any]]
) -> NDArray[Any]:
    """Samples to predict for, as above."""
    if _is_plain(model, X):
        return np.asarray(X, dtype=dtype)
    return np.asarray(validate_data(model, X, dtype=dtype, order="C", reset=False))


def _is_plain(model: BaseEstimator, X: ArrayLike) -> bool:
    return (
        type(X) is np.ndarray
        and X.dtype == np.float32
        and X.ndim == 2
        and X.flags.c_contiguous
        and X.shape[1] == model.n_features_in_
        and X.shape[0] > 0
        and bool(np.isfinite(X).all())
    )


def _are_plain_targets(X: ArrayLike, y: ArrayLike) -> bool:
    return (
        type(y) is np.ndarray
        and y.dtype == np.float64
        and y.shape == np.shape(X)[:1]
        and bool(np.isfinite(y).all())
    )
