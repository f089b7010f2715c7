"""Time is passed in: the only module that reads the host's clock."""

import asyncio
import time
from typing import Protocol


class Clock(Protocol):
    """Seconds that the vehicle's world has seen; deadlines and staleness use it."""

    def now_s(self) -> float: ...

    async def sleep(self, duration_s: float) -> None: ...


class WallClock:
    """The host's monotonic clock, times the speed at which the simulated world runs."""

    def __init__(self, speed: float = 1.0) -> None:
        self.speed = speed

    def now_s(self) -> float:
        return time.monotonic() * self.speed

    async def sleep(self, duration_s: float) -> None:
        await asyncio.sleep(duration_s / self.speed)


class SimClock:
    """Simulated time: moves only when the world is stepped."""

    def __init__(self) -> None:
        self.time_s = 0.0

    def now_s(self) -> float:
        return self.time_s

    async def sleep(self, duration_s: float) -> None:
        await let_others_run()


async def let_others_run() -> None:
    """Gives the event loop one turn; no time passes."""
    await asyncio.sleep(0)


def unix_s() -> float:
    """The host's date in seconds since 1970, for what is compared with the dates of others."""
    return time.time()


def wall_s() -> float:
    """Wall time in seconds from an arbitrary origin, for durations that a user waits."""
    return time.perf_counter()
