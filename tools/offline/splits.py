"""What is learned from and what is scored: by recording or by time, never by random frame."""

from collections.abc import Sequence
from typing import Annotated, Literal, NamedTuple

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from companion.kernel.errors import PlanError
from companion.kernel.settings import Settings

BLOCK_FRAMES = 50
"""Scored in one run where not all frames are: long enough for the estimate to be smoothed."""
GOLDEN_RATIO = (5.0**0.5 - 1.0) / 2.0


class SplitSettings(Settings, frozen=True):
    """``[[split]]``: one way to part recordings into training and test set."""

    name: str = ""
    kind: Literal["recordings", "time", "random"] = "recordings"
    folds: Annotated[int, Meta(ge=2, le=100)] = 2
    """Kind "recordings": fold i tests every folds-th recording from the i-th on."""
    train: tuple[str, ...] = ()
    test: tuple[str, ...] = ()
    """Kind "recordings": their names, instead of folds."""
    test_norm: Annotated[float, Meta(gt=0.0, lt=1.0)] = 1.0 / 3.0
    """Kind "time": the share at the end of each recording that is tested."""
    allow_random_split: bool = False

    def __post_init__(self) -> None:
        if self.kind == "random" and not self.allow_random_split:
            raise ValueError(
                'kind "random" is refused: neighbouring frames are near-copies, so that the test '
                "set would be known by heart (AUC 0.98 where recordings not seen give 0.57 to "
                '0.92); choose "recordings" or "time", or say allow_random_split = true'
            )
        if bool(self.train) != bool(self.test):
            raise ValueError("train and test are lists of names, both or neither")

    @property
    def label(self) -> str:
        return self.name or self.kind


class Part(NamedTuple):
    """Frames of one recording, by their rows in ascending order."""

    recording: int
    rows: NDArray[np.int64]


Parts = tuple[Part, ...]


class Fold(NamedTuple):
    """One training set and the test set that belongs to it."""

    split: str
    number: int
    train: Parts
    test: Parts


def folds_of(
    settings: SplitSettings, names: Sequence[str], lengths: Sequence[int], seed: int
) -> list[Fold]:
    """All folds over recordings with these names and numbers of frames. Raises PlanError."""
    if settings.kind == "recordings":
        pairs = _by_recording(settings, names)
        whole = [np.arange(length) for length in lengths]
        parts = [tuple(tuple(Part(i, whole[i]) for i in side) for side in pair) for pair in pairs]
    else:
        parts = [_within(settings, lengths, seed)]
    return [Fold(settings.label, number, *pair) for number, pair in enumerate(parts)]


def _by_recording(
    settings: SplitSettings, names: Sequence[str]
) -> list[tuple[list[int], list[int]]]:
    if settings.train:
        return [(_places(settings.train, names), _places(settings.test, names))]
    n_folds = min(settings.folds, len(names))
    if n_folds < 2:
        raise PlanError(
            f'split "{settings.label}": by recording, but only {names[0]} is given; '
            'give more recordings, or split by kind = "time"'
        )
    every = range(len(names))
    tested = [list(every[first::n_folds]) for first in range(n_folds)]
    return [([place for place in every if place not in test], test) for test in tested]


def _places(wanted: Sequence[str], names: Sequence[str]) -> list[int]:
    for name in wanted:
        if name not in names:
            raise PlanError(f"split: no recording {name!r}; given are: {', '.join(names)}")
    return [names.index(name) for name in wanted]


def _within(settings: SplitSettings, lengths: Sequence[int], seed: int) -> tuple[Parts, Parts]:
    rng = np.random.default_rng(seed)
    train, test = [], []
    for recording, length in enumerate(lengths):
        rows = np.arange(length) if settings.kind == "time" else rng.permutation(length)
        first_tested = round(length * (1.0 - settings.test_norm))
        train.append(Part(recording, np.sort(rows[:first_tested])))
        test.append(Part(recording, np.sort(rows[first_tested:])))
    return tuple(train), tuple(test)


def in_flight_order(parts: Parts) -> NDArray[np.int64]:
    """(n, 2): recording and row of every frame, as they were flown."""
    columns = [np.column_stack([np.full(len(p.rows), p.recording), p.rows]) for p in parts]
    return np.concatenate(columns).astype(np.int64)


def spread(frames: NDArray[np.int64]) -> NDArray[np.int64]:
    """The same frames so ordered that the first n lie evenly over all of them, for every n."""
    places = np.arange(len(frames)) * GOLDEN_RATIO % 1.0
    order = np.empty(len(frames), dtype=np.int64)
    order[np.argsort(places, kind="stable")] = np.arange(len(frames))
    # order[i] is now the rank of the i-th point of the sequence: where it falls among all.
    return frames[order]


def thinned(frames: NDArray[np.int64], limit: int | None) -> NDArray[np.int64]:
    """About ``limit`` frames, in runs of BLOCK_FRAMES that lie evenly over all."""
    if limit is None or len(frames) <= limit:
        return frames
    n_blocks = max(1, limit // BLOCK_FRAMES)
    starts = np.linspace(0, len(frames) - BLOCK_FRAMES, n_blocks).round().astype(np.int64)
    rows = np.unique(starts[:, np.newaxis] + np.arange(BLOCK_FRAMES))
    return frames[rows[rows < len(frames)]]
