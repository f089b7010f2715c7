"""The nearest of many samples, exactly, while samples come and go one by one.

Like samples lie together in tiles of at most TILE, features first, so that the distance loop runs
across samples in the processor's vector registers. Each tile knows the box that its samples fill:
a query skips every tile whose box is farther than the neighbours it has already found. A tile that
is full is halved along its widest feature. Where samples fill their space evenly nothing can be
skipped, and all are compared.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from companion.kernel.fastmath import FASTMATH

TILE = 128
"""Samples per tile: one tile of 21 features is 10 kB, a third of a first-level cache."""
SLACK = np.float32(1.0 - 1e-5)
"""A rounding error may make a box seem farther than its nearest sample: never skipped for that."""
NOWHERE = -1

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
            n_done, self._n_tiles = _put(
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
        # The kernel is compiled for writable arrays; what is read-only gets copied.
        parts = self._tiles, self._slots, self._counts, self._boxes
        tiles, slots, counts, boxes = (np.require(part, None, "W") for part in parts)
        _nearest(tiles, slots, counts, boxes, self._n_tiles, queries, index)
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


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def _distances(rows, n_rows, query, distance):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202 - numba finds the types
    """Squared distance of the first ``n_rows`` columns of ``rows`` (n_features, any)."""
    distance[:n_rows] = 0.0
    for feature in range(len(query)):
        value = query[feature]
        for row in range(n_rows):
            difference = rows[feature, row] - value
            distance[row] += difference * difference


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def _bounds(boxes, n_tiles, query, bound):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202 - numba finds the types
    """Squared distance of each tile's box."""
    bound[:n_tiles] = 0.0
    for feature in range(len(query)):
        value = query[feature]
        for tile in range(n_tiles):
            below, above = boxes[0, feature, tile] - value, value - boxes[1, feature, tile]
            outside = max(max(below, above), np.float32(0.0))
            bound[tile] += outside * outside


@njit(cache=True, nogil=True)
def _keep_nearest(distance, n_rows, slots, nearest, index):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202 - numba finds the types
    """Insertion into the sorted list of the nearest; of equals, the lower slot goes first."""
    last = len(nearest) - 1
    for row in range(n_rows):
        candidate = distance[row]
        if candidate > nearest[last]:
            continue
        slot = slots[row]
        if candidate == nearest[last] and slot > index[last]:
            continue
        place = last
        while place > 0 and (
            nearest[place - 1] > candidate
            or (nearest[place - 1] == candidate and index[place - 1] > slot)
        ):
            nearest[place] = nearest[place - 1]
            index[place] = index[place - 1]
            place -= 1
        nearest[place] = candidate
        index[place] = slot


@njit(cache=True, nogil=True)
def _search(tiles, slots, counts, boxes, n_tiles, query, distance, bound, nearest, index):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202 - numba finds the types
    """The most promising tile first, then those not excluded by then, in the order of promise."""
    _bounds(boxes, n_tiles, query, bound)
    first = np.argmin(bound[:n_tiles])
    _distances(tiles[first], counts[first], query, distance)
    _keep_nearest(distance, counts[first], slots[first], nearest, index)
    last = len(nearest) - 1
    left = np.flatnonzero(bound[:n_tiles] * SLACK <= nearest[last])
    for tile in left[np.argsort(bound[left], kind="mergesort")]:
        if bound[tile] * SLACK > nearest[last]:
            break
        if tile != first:
            _distances(tiles[tile], counts[tile], query, distance)
            _keep_nearest(distance, counts[tile], slots[tile], nearest, index)


# Signatures are given so that kernels are compiled, or read from the cache, before take-off.
@njit(
    "void(f4[:,:,::1], i8[:,::1], i8[::1], f4[:,:,::1], i8, f4[:,::1], i8[:,::1])",
    cache=True,
    nogil=True,
)
def _nearest(tiles, slots, counts, boxes, n_tiles, queries, index):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202 - numba finds the types
    distance = np.empty(TILE, dtype=np.float32)
    bound = np.empty(n_tiles, dtype=np.float32)
    nearest = np.empty(index.shape[1], dtype=np.float32)
    for row in range(len(queries)):
        nearest[:] = np.inf
        index[row] = np.iinfo(np.int64).max
        _search(
            tiles, slots, counts, boxes, n_tiles, queries[row], distance, bound, nearest, index[row]
        )


@njit(cache=True, nogil=True)
def _add(tiles, slots, counts, centres, boxes, places, tile, sample, slot):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202 - numba finds the types
    column = counts[tile]
    for feature in range(len(sample)):
        value = sample[feature]
        tiles[tile, feature, column] = value
        if column == 0:
            boxes[0, feature, tile] = boxes[1, feature, tile] = centres[feature, tile] = value
        else:
            boxes[0, feature, tile] = min(boxes[0, feature, tile], value)
            boxes[1, feature, tile] = max(boxes[1, feature, tile], value)
            centres[feature, tile] += (value - centres[feature, tile]) / np.float32(column + 1)
    slots[tile, column] = slot
    places[slot] = tile * TILE + column
    counts[tile] = column + 1


@njit(cache=True, nogil=True)
def _remove(tiles, slots, counts, places, slot):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202 - numba finds the types
    """The tile's last sample takes its column; the box stays: it may be too wide, never narrow."""
    tile, column = places[slot] // TILE, places[slot] % TILE
    last = counts[tile] - 1
    tiles[tile, :, column] = tiles[tile, :, last]
    slots[tile, column] = slots[tile, last]
    places[slots[tile, last]] = tile * TILE + column
    places[slot] = NOWHERE
    counts[tile] = last


@njit(cache=True, nogil=True)
def _halve(tiles, slots, counts, centres, boxes, places, tile, other):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202 - numba finds the types
    """Half of ``tile`` goes to ``other``: the samples above the median of the widest feature."""
    samples, held = tiles[tile].T.copy(), slots[tile].copy()
    widest = 0
    for feature in range(len(centres)):
        if samples[:, feature].var() > samples[:, widest].var():
            widest = feature
    order = np.argsort(samples[:, widest], kind="mergesort")
    counts[tile] = 0
    for rank in range(TILE):
        to = tile if rank < TILE // 2 else other
        row = order[rank]
        _add(tiles, slots, counts, centres, boxes, places, to, samples[row], held[row])


@njit(cache=True, nogil=True)
def _nearer(centres, sample, one, other):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202 - numba finds the types
    to_one = ((centres[:, one] - sample) ** 2).sum()
    return one if to_one <= ((centres[:, other] - sample) ** 2).sum() else other


@njit(
    "UniTuple(i8, 2)(f4[:,:,::1], i8[:,::1], i8[::1], f4[:,::1], f4[:,:,::1], i8[::1], i8,"
    " f4[:,::1], i8[::1], i8)",
    cache=True,
    nogil=True,
)
def _put(tiles, slots, counts, centres, boxes, places, n_tiles, samples, into, begin):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202 - numba finds the types
    """Puts samples from ``begin`` on while there is room for a tile; returns how far it came."""
    distance = np.empty(len(counts), dtype=np.float32)
    n_tiles = max(n_tiles, 1)
    for row in range(begin, len(into)):
        if places[into[row]] != NOWHERE:
            _remove(tiles, slots, counts, places, into[row])
        _distances(centres, n_tiles, samples[row], distance)
        tile = np.argmin(distance[:n_tiles])
        if counts[tile] == TILE:
            if n_tiles == len(counts):
                return row, n_tiles
            _halve(tiles, slots, counts, centres, boxes, places, tile, n_tiles)
            n_tiles += 1
            tile = _nearer(centres, samples[row], tile, n_tiles - 1)
        _add(tiles, slots, counts, centres, boxes, places, tile, samples[row], into[row])
    return len(into), n_tiles
