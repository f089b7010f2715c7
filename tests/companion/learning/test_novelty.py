"""Novelty is low where the learner learned, high elsewhere, and keeps its meaning when saved."""

import math

import numpy as np
import pytest

from companion.learning.novelty import CAPACITY, Novelty

ROOM, OTHER_ROOM = np.full(12, 2.0, np.float32), np.full(12, 4.0, np.float32)


def frames(n_frames, seed, centre=ROOM):
    """A flight: features drift about the room's, neighbours alike."""
    steps = np.random.default_rng(seed).normal(size=(n_frames + 40, 12))
    smooth = np.stack([np.convolve(column, np.ones(40) / 40.0, "valid") for column in steps.T])
    return centre + smooth.T[:n_frames].astype(np.float32)


def taught(rows):
    novelty = Novelty()
    for row in rows:
        novelty.learn(row)
    return novelty


@pytest.fixture(scope="module")
def learned():
    return taught(frames(1500, 1))


def test_the_same_room_at_another_time_is_not_novel(learned):
    figures = [learned.of(row) for row in frames(400, 2)]
    assert np.median(figures) < 0.8
    assert np.mean(np.array(figures) < 1.0) > 0.8


def test_another_room_is_novel(learned):
    assert min(learned.of(row) for row in frames(100, 3, OTHER_ROOM)) > 1.5


def test_a_frame_that_was_remembered_is_not_novel_at_all(learned):
    assert learned.of(frames(1500, 1)[0]) == pytest.approx(0.0, abs=1e-6)


def test_a_step_where_nothing_ever_varied_is_more_novel_than_one_along_what_varies():
    rows = frames(600, 7)
    rows[:, 0] = 5.0 * rows[:, 0]
    novelty = taught(rows)
    steps = [3.0 * np.eye(12, dtype=np.float32)[place] for place in (0, 11)]
    along, across = (novelty.of(ROOM * np.where(steps[0], 5, 1) + step) for step in steps)
    assert across > 2.0 * along


def test_novelty_is_unknown_until_there_is_something_to_compare_with():
    novelty = Novelty()
    rows = frames(200, 1)
    assert math.isnan(novelty.of(rows[0]))
    for row in rows[:90]:
        novelty.learn(row)
    assert math.isnan(novelty.of(rows[100]))
    for row in rows[90:]:
        novelty.learn(row)
    assert novelty.of(rows[100]) >= 0.0


def test_frames_all_alike_give_no_unit():
    assert math.isnan(taught([ROOM] * 300).of(OTHER_ROOM))


def test_memory_is_bounded_and_spread_over_the_whole_flight():
    times = taught(frames(5 * CAPACITY + 3, 4)).state()["times"]
    assert CAPACITY // 2 <= len(times) <= CAPACITY
    assert times[0] == 0
    assert len(set(np.diff(times))) == 1
    assert times[-1] > 4.9 * CAPACITY


@pytest.mark.parametrize("n_frames", [0, 30, 700, 1500])
def test_restored_it_goes_on_to_the_bit(n_frames):
    rows = frames(n_frames + 100, 5)
    original = taught(rows[:n_frames])
    restored = Novelty.restored(original.state())
    for row in rows[n_frames:]:
        assert original.of(row) == restored.of(row) or math.isnan(restored.of(row))
        original.learn(row)
        restored.learn(row)
    for name, values in original.state().items():
        np.testing.assert_array_equal(restored.state()[name], values)
