"""How the arena's kernels are compiled."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit

from companion.kernel.fastmath import FASTMATH

F = TypeVar("F", bound=Callable[..., Any])


def kernel(function: F) -> F:
    """Compiled on first use and kept on disk; needs no interpreter lock.

    Divides as NumPy does: a check for zero would keep loops from becoming vector instructions.
    """
    compiled = njit(cache=True, fastmath=FASTMATH, nogil=True, error_model="numpy")(function)
    return cast(F, compiled)
