"""Doing again what a bad link or an unlucky moment spoilt."""

from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import TypeVar

T = TypeVar("T")


async def attempt(
    times: int, spoilt_by: type[BaseException], action: Callable[[], Awaitable[T]]
) -> T:
    """``action()``, at most so many times; what spoils the last one is raised."""
    for _ in range(times - 1):
        with suppress(spoilt_by):
            return await action()
    return await action()
