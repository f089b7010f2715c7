"""What a bounded memory keeps, told by the numbers of the samples in its slots."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.regressors import RegressorSettings, make
from companion.regressors.slots import SlotMemory

KEEPS = ["newest", "mixed"]


def remembered(memory, contents, n_samples, first=0):
    """Fills ``contents`` with the numbers of samples as the memory says."""
    for number in range(first, first + n_samples):
        (slot,) = memory.take(1)
        contents[slot] = number
    return contents


@given(keep=st.sampled_from(KEEPS), capacity=st.integers(1, 30), n_samples=st.integers(0, 200))
def test_it_holds_as_many_as_fit_each_in_a_slot_of_its_own(keep, capacity, n_samples):
    memory = SlotMemory(capacity, keep)
    contents = remembered(memory, {}, n_samples)
    order = memory.order()
    assert memory.n_kept == len(contents) == len(order) == min(n_samples, capacity)
    assert sorted(order) == list(range(len(order)))
    held = [contents[slot] for slot in order]
    if keep == "newest":
        assert held == list(range(n_samples))[-capacity:]
    else:
        n_newest = min(len(held), capacity - capacity // 2)
        assert held[len(held) - n_newest :] == list(range(n_samples - n_newest, n_samples))


def test_the_past_is_kept_evenly():
    counts = np.zeros(4)
    for seed in range(200):
        memory = SlotMemory(40, "mixed", seed)
        contents = remembered(memory, {}, 420)
        past = [contents[slot] for slot in memory.order()[:20]]
        counts += np.histogram(past, bins=4, range=(0, 400))[0]
    assert counts.sum() == 200 * 20
    assert counts == pytest.approx(1000, rel=0.12)


@pytest.mark.parametrize("keep", KEEPS)
@pytest.mark.parametrize("n_samples", [3, 16, 90])
def test_a_restored_memory_goes_on_as_the_original(keep, n_samples):
    original = SlotMemory(16, keep, seed=5)
    contents = remembered(original, {}, n_samples)
    restored = SlotMemory(16, keep, seed=5)
    held = [contents[slot] for slot in original.order()]
    slots = restored.restore(original.n_seen, len(held), original.order())
    again = dict(zip(slots, held, strict=True))
    assert again == contents
    for memory, kept in ((original, contents), (restored, again)):
        remembered(memory, kept, 60, first=n_samples)
    assert [contents[s] for s in original.order()] == [again[s] for s in restored.order()]


def test_many_at_once_are_as_one_by_one():
    one, many = SlotMemory(10, "mixed"), SlotMemory(10, "mixed")
    slots = [int(slot) for _ in range(37) for slot in one.take(1)]
    assert slots == list(many.take(37))


@pytest.mark.parametrize("keep", KEEPS)
def test_a_memory_that_was_saved_smaller_has_room_for_more(keep):
    small, large = SlotMemory(16, keep), SlotMemory(40, keep)
    contents = remembered(small, {}, 90)
    held = [contents[slot] for slot in small.order()]
    again = dict(zip(large.restore(90, 16, small.order()), held, strict=True))
    remembered(large, again, 24, first=90)
    assert [again[slot] for slot in large.order()] == [*held, *range(90, 114)]


@pytest.mark.parametrize("keep", KEEPS)
@pytest.mark.parametrize("name", ["knn", "mlp"])
def test_a_model_that_was_saved_smaller_learns_on(name, keep):
    rng = np.random.default_rng(4)
    X, y = rng.normal(size=(60, 3)).astype(np.float32), np.arange(60.0)
    small, large = (make(name, RegressorSettings(capacity=n, keep=keep)) for n in (10, 30))
    for row in range(50):
        small.partial_fit(X[row : row + 1], y[row : row + 1])
    large.restore(small.state()).partial_fit(X[50:], y[50:])
    assert large.state()["y"].tolist() == [*small.state()["y"], *range(50, 60)]
