"""How loops over pixels and samples are compiled."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit

from companion.kernel.fastmath import FASTMATH

F = TypeVar("F", bound=Callable[..., Any])


def kernel(signature: str | None = None, *, fast: bool = False) -> Callable[[F], F]:
    """Kept on disk once compiled; needs no interpreter lock.

    With numba's ``signature`` it is compiled, or read from the disk, when it is imported: before
    take-off. Without one, as the kernels that call it need it. ``fast``: with FASTMATH.
    """
    liberties = FASTMATH if fast else False
    return cast(Callable[[F], F], njit(signature, cache=True, nogil=True, fastmath=liberties))
