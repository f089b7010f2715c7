"""What a bounded memory of samples keeps: the slots that new samples go to.

``newest`` forgets the oldest. ``mixed`` keeps the newest in one half, and in the other an even
sample of all that came before them (Vitter's reservoir): a room that was left long ago is still
known, and a new one is learned as fast.
"""

from collections import deque
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Keep = Literal["newest", "mixed"]
Slots = NDArray[np.int64]


class SlotMemory:
    """Slots 0 to ``capacity`` - 1, filled in order and then used again as ``keep`` says."""

    def __init__(self, capacity: int, keep: Keep = "newest", seed: int = 0) -> None:
        self.capacity = capacity
        self.keep = keep
        self.n_seen = 0
        self._seed = seed
        self._n_newest = capacity - capacity // 2
        self._newest: deque[int] = deque()
        self._past: list[int] = []

    @property
    def n_kept(self) -> int:
        return min(self.n_seen, self.capacity)

    def take(self, n_samples: int) -> Slots:
        """Of the next samples, in their order: where one slot comes twice, the later one stays."""
        if self.keep == "newest":
            slots = (self.n_seen + np.arange(n_samples)) % self.capacity
            self.n_seen += n_samples
            return slots
        return np.array([self._take_mixed() for _ in range(n_samples)], dtype=np.int64)

    def order(self) -> Slots:
        """The slots in use: the oldest first, and the even sample before the newest."""
        if self.keep == "mixed":
            return np.array([*self._past, *self._newest], dtype=np.int64)
        oldest = self.n_seen % self.capacity if self.n_seen > self.capacity else 0
        return np.roll(np.arange(self.n_kept), -oldest)

    def restore(self, n_seen: int, n_kept: int, order: Slots | None = None) -> Slots:
        """As after ``n_seen`` samples of which ``n_kept`` came back, the oldest first.

        ``order`` is what it was when they were saved. Returns the slots that they go to. Where
        there is room for more than came back, the others are as if never seen.
        """
        self.n_seen = n_seen if n_kept == min(n_seen, self.capacity) else n_kept
        if self.keep == "newest":
            return (self.n_seen - n_kept + np.arange(n_kept)) % self.capacity
        slots = np.arange(n_kept) if order is None or len(order) != n_kept else order
        n_past = n_kept - min(n_kept, self._n_newest)
        self._past, self._newest = slots[:n_past].tolist(), deque(slots[n_past:].tolist())
        return slots

    def _take_mixed(self) -> int:
        slot = self.n_seen if self.n_seen < self.capacity else -1
        if len(self._newest) == self._n_newest:
            slot = self._retire(slot)
        self._newest.append(slot)
        self.n_seen += 1
        return slot

    def _retire(self, free: int) -> int:
        """The oldest of the newest becomes one of the past, or makes room. The free slot."""
        oldest = self._newest.popleft()
        if free >= 0:
            self._past.append(oldest)
            return free
        n_past = self.n_seen - self._n_newest + 1
        # A generator per sample: a restored memory goes on as the original would.
        place = int(np.random.default_rng([self._seed, self.n_seen]).integers(n_past))
        if place >= len(self._past):
            return oldest
        free, self._past[place] = self._past[place], oldest
        return free
