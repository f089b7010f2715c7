"""What a radio link does to packets: loses, delays, overtakes and repeats them; seeded."""

from collections.abc import Callable, Iterator, Sequence
from heapq import heappop, heappush
from typing import Annotated, Final, Generic, TypeVar

import numpy as np
from msgspec import Meta

from companion.kernel.settings import Settings

Norm = Annotated[float, Meta(ge=0.0, le=1.0)]
Delay = Annotated[float, Meta(ge=0.0, le=60.0)]
T = TypeVar("T")

MOST_WAITING: Final = 10_000
"""Packets on their way in one direction; what is more is lost, so that memory stays bounded."""


class LinkSettings(Settings, frozen=True):
    """Both directions alike; times are the simulated world's."""

    loss_norm: Norm = 0.0
    """Probability that a packet is lost."""
    latency_s: Delay = 0.0
    jitter_s: Delay = 0.0
    """Each packet takes up to this much longer, evenly spread: later ones overtake it."""
    duplicate_norm: Norm = 0.0
    """Probability that a packet comes twice."""


CLEAR: Final = LinkSettings()
_STREAM: Final = 2  # key of the links' random numbers; the world's is 0, the camera's 1


class LinkConditions:
    """The conditions of one link. ``settings`` may be replaced at any time."""

    def __init__(self, settings: LinkSettings, rng: np.random.Generator) -> None:
        self.settings = settings
        self._rng = rng

    @property
    def clear(self) -> bool:
        return self.settings == CLEAR

    def delays_s(self) -> Sequence[float]:
        """How long one packet travels: one entry for each copy that arrives."""
        now = self.settings
        if now == CLEAR:
            return (0.0,)
        if self._rng.random() < now.loss_norm:
            return ()
        copies = 2 if self._rng.random() < now.duplicate_norm else 1
        return [now.latency_s + now.jitter_s * self._rng.random() for _ in range(copies)]


class Pipe(Generic[T]):
    """One direction of a link: what is put in comes out when, and as often as, it arrives."""

    def __init__(self, conditions: LinkConditions, now_s: Callable[[], float]) -> None:
        self._conditions = conditions
        self._now_s = now_s
        self._waiting: list[tuple[float, int, T]] = []
        self._count = 0

    def put(self, packet: T) -> None:
        for delay_s in self._conditions.delays_s():
            if len(self._waiting) < MOST_WAITING:
                self._count += 1  # packets of the same moment keep their order
                heappush(self._waiting, (self._now_s() + delay_s, self._count, packet))

    def due(self) -> Iterator[T]:
        """Takes out what has arrived by now."""
        while self._waiting and self._waiting[0][0] <= self._now_s():
            yield heappop(self._waiting)[2]


def link_rng(seed: int, number: int = 0) -> np.random.Generator:
    """The random numbers of one link; the companion's is number 0."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_STREAM, number)))
