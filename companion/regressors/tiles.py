"""Tiles of samples as neighbours.Neighbours lays them out: the loops over them, compiled.

tiles: (n_tiles, n_features, TILE); slots (n_tiles, TILE) and counts (n_tiles,) of their samples;
centres (n_features, n_tiles); boxes (2, n_features, n_tiles), low and high ends; places: of each
slot, tile * TILE + column, or NOWHERE.
"""

import numpy as np
from numpy.typing import NDArray

from companion.compiled import kernel

TILE = 128
"""Samples per tile: one tile of 21 features is 10 kB, a third of a first-level cache."""
SLACK = np.float32(1.0 - 1e-5)
"""A rounding error may make a box seem farther than its nearest sample: never skipped for that."""
NOWHERE = -1

Floats32 = NDArray[np.float32]
Integers = NDArray[np.int64]


@kernel(fast=True)
def _distances(rows: Floats32, n_rows: int, query: Floats32, distance: Floats32) -> None:
    """Squared distance of the first ``n_rows`` columns of ``rows`` (n_features, any)."""
    distance[:n_rows] = 0.0
    for feature in range(len(query)):
        value = query[feature]
        for row in range(n_rows):
            difference = rows[feature, row] - value
            distance[row] += difference * difference


@kernel(fast=True)
def _bounds(boxes: Floats32, n_tiles: int, query: Floats32, bound: Floats32) -> None:
    """Squared distance of each tile's box."""
    bound[:n_tiles] = 0.0
    for feature in range(len(query)):
        value = query[feature]
        for tile in range(n_tiles):
            below, above = boxes[0, feature, tile] - value, value - boxes[1, feature, tile]
            outside = max(max(below, above), np.float32(0.0))
            bound[tile] += outside * outside


@kernel()
def _keep_nearest(
    distance: Floats32, n_rows: int, slots: Integers, nearest: Floats32, index: Integers
) -> None:
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


@kernel()
def _search(
    tiles: Floats32,
    slots: Integers,
    counts: Integers,
    boxes: Floats32,
    n_tiles: int,
    query: Floats32,
    distance: Floats32,
    bound: Floats32,
    nearest: Floats32,
    index: Integers,
) -> None:
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
@kernel("void(f4[:,:,::1], i8[:,::1], i8[::1], f4[:,:,::1], i8, f4[:,::1], i8[:,::1])")
def find_nearest(
    tiles: Floats32,
    slots: Integers,
    counts: Integers,
    boxes: Floats32,
    n_tiles: int,
    queries: Floats32,
    index: Integers,
) -> None:
    distance = np.empty(TILE, dtype=np.float32)
    bound = np.empty(n_tiles, dtype=np.float32)
    nearest = np.empty(index.shape[1], dtype=np.float32)
    for row in range(len(queries)):
        nearest[:] = np.inf
        index[row] = np.iinfo(np.int64).max
        _search(
            tiles, slots, counts, boxes, n_tiles, queries[row], distance, bound, nearest, index[row]
        )


@kernel()
def _add(
    tiles: Floats32,
    slots: Integers,
    counts: Integers,
    centres: Floats32,
    boxes: Floats32,
    places: Integers,
    tile: int,
    sample: Floats32,
    slot: int,
) -> None:
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


@kernel()
def _remove(
    tiles: Floats32, slots: Integers, counts: Integers, places: Integers, slot: int
) -> None:
    """The tile's last sample takes its column; the box stays: it may be too wide, never narrow."""
    tile, column = places[slot] // TILE, places[slot] % TILE
    last = counts[tile] - 1
    tiles[tile, :, column] = tiles[tile, :, last]
    slots[tile, column] = slots[tile, last]
    places[slots[tile, last]] = tile * TILE + column
    places[slot] = NOWHERE
    counts[tile] = last


@kernel()
def _halve(
    tiles: Floats32,
    slots: Integers,
    counts: Integers,
    centres: Floats32,
    boxes: Floats32,
    places: Integers,
    tile: int,
    other: int,
) -> None:
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


@kernel()
def _nearer(centres: Floats32, sample: Floats32, one: int, other: int) -> int:
    to_one = ((centres[:, one] - sample) ** 2).sum()
    return one if to_one <= ((centres[:, other] - sample) ** 2).sum() else other


@kernel(
    "UniTuple(i8, 2)(f4[:,:,::1], i8[:,::1], i8[::1], f4[:,::1], f4[:,:,::1], i8[::1], i8,"
    " f4[:,::1], i8[::1], i8)"
)
def put_samples(
    tiles: Floats32,
    slots: Integers,
    counts: Integers,
    centres: Floats32,
    boxes: Floats32,
    places: Integers,
    n_tiles: int,
    samples: Floats32,
    into: Integers,
    begin: int,
) -> tuple[int, int]:
    """Puts samples from ``begin`` on while there is room for a tile; returns how far it came."""
    distance = np.empty(len(counts), dtype=np.float32)
    n_tiles = max(n_tiles, 1)
    for row in range(begin, len(into)):
        if places[into[row]] != NOWHERE:
            _remove(tiles, slots, counts, places, into[row])
        _distances(centres, n_tiles, samples[row], distance)
        tile = int(np.argmin(distance[:n_tiles]))
        if counts[tile] == TILE:
            if n_tiles == len(counts):
                return row, n_tiles
            _halve(tiles, slots, counts, centres, boxes, places, tile, n_tiles)
            n_tiles += 1
            tile = _nearer(centres, samples[row], tile, n_tiles - 1)
        _add(tiles, slots, counts, centres, boxes, places, tile, samples[row], into[row])
    return len(into), n_tiles
