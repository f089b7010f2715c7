"""The nearest of many samples, exactly, while samples come and go one by one.

Like samples lie together in tiles of at most TILE, features first, so that the distance loop runs
across samples in the processor's vector registers. Each tile knows the box that its samples fill:
a query skips every tile whose box is farther than the neighbours it has already found. A tile that
is full is halved along its widest feature. Where samples fill their space evenly nothing can be
skipped, and all are compared.
"""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from companion.regressors.tiles import NOWHERE, TILE, find_nearest, put_samples

T = TypeVar("T", bound=np.generic)
Floats32 = NDArray[np.float32]
Integers = NDArray[np.int64]


class Neighbours:
    """Samples by slot, 0 and up; putting one where one lies replaces it."""

    def __init__(self, n_features: int) -> None:
        self._tiles: Floats32 = np.zeros((0, n_features, TILE), dtype=np.float32)
        self._slots = np.zeros((0, TILE), dtype=np.int64)
        self._counts = np.zeros(0, dtype=np.int64)
        self._centres: Floats32 = np.zeros((n_features, 0), dtype=np.float32)
        self._boxes: Floats32 = np.zeros((2, n_features, 0), dtype=np.float32)
        """Low and high ends; tiles side by side, as samples are in a tile."""
        self._places = np.zeros(0, dtype=np.int64)
        """Of each slot: tile * TILE + column, or NOWHERE."""
        self._n_tiles = 0

    def copy(self) -> "Neighbours":
        """Shares nothing with this one."""
        twin = Neighbours(self._tiles.shape[1])
        vars(twin).update(
            {
                name: value.copy() if isinstance(value, np.ndarray) else value
                for name, value in vars(self).items()
            }
        )
        return twin

    def put(self, samples: Floats32, slots: Integers) -> None:
        """Samples (n, n_features) into ``slots`` (n,)."""
        self._make_places(int(slots.max(initial=-1)) + 1)
        n_done = 0
        while n_done < len(slots):
            # Each sample may halve a tile, so there must be room for one more.
            if self._n_tiles == len(self._tiles):
                self._make_tiles(max(2 * self._n_tiles, 1))
            n_done, self._n_tiles = put_samples(
                self._tiles,
                self._slots,
                self._counts,
                self._centres,
                self._boxes,
                self._places,
                self._n_tiles,
                samples,
                slots,
                n_done,
            )

    def rows(self, n_slots: int) -> Floats32:
        """Samples of the slots below ``n_slots``, (n_slots, n_features)."""
        tile, column = np.divmod(self._places[:n_slots], TILE)
        return self._tiles[tile, :, column]

    def nearest(self, queries: Floats32, k: int) -> Integers:
        """Slots of the ``k`` nearest samples to each query, nearest first: (n_queries, k).

        There must be that many. Of samples equally near, the lower slot comes first.
        """
        index = np.empty((len(queries), k), dtype=np.int64)
        # The kernel is compiled for writable arrays.
        find_nearest(
            _writable(self._tiles),
            _writable(self._slots),
            _writable(self._counts),
            _writable(self._boxes),
            self._n_tiles,
            queries,
            index,
        )
        return index

    def _make_places(self, n_slots: int) -> None:
        missing = n_slots - len(self._places)
        if missing > 0:
            more = np.full(max(missing, len(self._places)), NOWHERE, dtype=np.int64)
            self._places = np.concatenate([self._places, more])

    def _make_tiles(self, n_tiles: int) -> None:
        """Room for ``n_tiles``, of which the new ones are empty."""
        extra = n_tiles - len(self._tiles)
        self._tiles = np.pad(self._tiles, ((0, extra), (0, 0), (0, 0)))
        self._slots = np.pad(self._slots, ((0, extra), (0, 0)))
        self._counts = np.pad(self._counts, (0, extra))
        self._centres = np.pad(self._centres, ((0, 0), (0, extra)))
        self._boxes = np.pad(self._boxes, ((0, 0), (0, 0), (0, extra)))


def _writable(array: NDArray[T]) -> NDArray[T]:
    """The array itself if it may be written to, else a copy."""
    return np.require(array, None, "W")
