"""Arrays by name, some of them under the name of the part of a learner that they belong to."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, NDArray[np.generic]]


def part(state: Arrays, name: str) -> Arrays:
    """The arrays that ``whole`` put under this name."""
    prefix = f"{name}."
    return {
        key.removeprefix(prefix): values for key, values in state.items() if key.startswith(prefix)
    }


def whole(**parts: Mapping[str, NDArray[np.generic]]) -> Arrays:
    """The parts' arrays, each under its part's name."""
    return {
        f"{name}.{key}": values for name, part_ in parts.items() for key, values in part_.items()
    }


def refuse_misfits(arrays: Arrays, like: Arrays) -> None:
    """Names, kinds and shapes must be as in ``like``; only rows may be more.

    Raises KeyError or ValueError.
    """
    for name, wanted in like.items():
        found = arrays[name]
        rows_differ = wanted.shape[:1] in ((0,), (1,)) and found.shape[1:] == wanted.shape[1:]
        if found.dtype != wanted.dtype or not (rows_differ or found.shape == wanted.shape):
            raise ValueError(f"{name} of shape {found.shape} and type {found.dtype}")
        if found.dtype.kind == "f" and not np.isfinite(found).all():
            raise ValueError(f"{name} is not finite")
