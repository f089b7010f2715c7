"""Requests that block, as MAVSDK's do until they are answered or given up."""

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor


class Requests:
    """Makes them on threads of its own.

    Nobody may be inside a library that is taken down: MAVSDK never returns from a request under
    way then, and the thread keeps its process from ending.
    """

    def __init__(self) -> None:
        self._threads = ThreadPoolExecutor(thread_name_prefix="request")

    async def make(self, request: Callable[[], None]) -> None:
        """Cancelling leaves the request to its thread."""
        await asyncio.get_running_loop().run_in_executor(self._threads, request)

    def close(self) -> None:
        """Waits for what is under way."""
        self._threads.shutdown()
