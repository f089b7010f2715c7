"""Splits keep what was seen apart from what is tested, and say why a random one does not."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.kernel.errors import PlanError
from companion.kernel.settings import convert_settings
from tools.offline.splits import (
    BLOCK_FRAMES,
    SplitSettings,
    folds_of,
    in_flight_order,
    spread,
    thinned,
)

NAMES, LENGTHS = ("a", "b", "c", "d", "e"), (10, 20, 30, 40, 50)


def split(**table):
    return convert_settings(table, SplitSettings, "study.toml: split")


def frames(parts):
    return {(int(recording), int(row)) for recording, row in in_flight_order(parts)}


def test_by_recording_every_recording_is_tested_once_and_never_by_one_that_learned_it():
    folds = folds_of(split(kind="recordings", folds=2), NAMES, LENGTHS, 1)
    tested = [part.recording for fold in folds for part in fold.test]
    assert sorted(tested) == [0, 1, 2, 3, 4]
    for fold in folds:
        assert not {p.recording for p in fold.train} & {p.recording for p in fold.test}
        assert len(frames(fold.train) | frames(fold.test)) == sum(LENGTHS)


def test_more_folds_than_recordings_leave_one_out():
    assert len(folds_of(split(kind="recordings", folds=9), NAMES, LENGTHS, 1)) == 5


def test_named_recordings():
    (fold,) = folds_of(split(train=["b", "c"], test=["e"]), NAMES, LENGTHS, 1)
    assert [part.recording for part in fold.train] == [1, 2]
    assert [part.recording for part in fold.test] == [4]
    with pytest.raises(PlanError, match="no recording 'z'; given are: a, b"):
        folds_of(split(train=["b"], test=["z"]), NAMES, LENGTHS, 1)


def test_by_time_the_end_of_each_recording_is_tested():
    (fold,) = folds_of(split(kind="time", test_norm=0.3), NAMES, LENGTHS, 1)
    for train, test, length in zip(fold.train, fold.test, LENGTHS, strict=True):
        assert train.rows.tolist() == list(range(round(0.7 * length)))
        assert test.rows.tolist() == list(range(round(0.7 * length), length))


def test_a_random_split_is_refused_with_the_reason_unless_it_is_said():
    with pytest.raises(PlanError, match=r"near-copies.*0\.98.*allow_random_split = true") as caught:
        split(kind="random")
    assert "\n" not in str(caught.value)
    (fold,) = folds_of(split(kind="random", allow_random_split=True), NAMES, LENGTHS, 1)
    assert not frames(fold.train) & frames(fold.test)
    assert len(frames(fold.train) | frames(fold.test)) == sum(LENGTHS)
    assert fold.test[4].rows.tolist() != list(range(33, 50))


def test_one_recording_cannot_be_split_by_recording():
    with pytest.raises(PlanError, match=r"only take is given; .* kind = .time"):
        folds_of(split(kind="recordings"), ["take"], [10], 1)


@given(st.integers(1, 500), st.data())
def test_the_first_n_of_a_spread_order_lie_evenly(n_frames, data):
    order = spread(np.column_stack([np.zeros(n_frames, int), np.arange(n_frames)]))
    assert sorted(order[:, 1].tolist()) == list(range(n_frames))
    n = data.draw(st.integers(1, n_frames))
    rows = np.sort(order[:n, 1])
    gaps = np.diff(np.concatenate([[-1], rows, [n_frames]]))
    assert gaps.max() <= 3 * n_frames / n + 2


@given(st.integers(1, 3000), st.integers(100, 1000))
def test_what_is_scored_is_in_runs_and_no_more_than_asked_for(n_frames, limit):
    every = np.column_stack([np.zeros(n_frames, int), np.arange(n_frames)])
    kept = thinned(every, limit)[:, 1]
    assert len(kept) <= max(limit, BLOCK_FRAMES)
    assert len(kept) >= min(n_frames, limit - BLOCK_FRAMES)
    assert (np.diff(kept) > 0).all()
