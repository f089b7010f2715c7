"""Spreads are corrected until they hold what a normal distribution promises."""

import numpy as np
import pytest

from companion.learning.doubt import DEVIATIONS, SHARES, STRETCH_FRAMES, Doubt
from companion.regressors import KNNRegressor


def judged(errors, spreads):
    doubt = Doubt()
    for error, spread in zip(errors, spreads, strict=True):
        doubt.note(float(error), float(spread))
    return doubt


def coverage(errors, spreads):
    ratios = np.abs(errors) / spreads
    return [float(np.mean(ratios < deviation)) for deviation in DEVIATIONS]


@pytest.mark.parametrize("belief", [0.1, 1.0, 5.0])
def test_a_boaster_and_a_pessimist_come_to_state_the_truth(belief):
    rng = np.random.default_rng(1)
    true = rng.uniform(0.5, 2.0, 1000)
    errors = rng.normal(0.0, true)
    doubt = judged(errors[:400], belief * true[:400])
    widened = doubt.widen(belief * true[400:])
    np.testing.assert_allclose(coverage(errors[400:], widened), SHARES, atol=0.12)


def test_order_is_kept():
    rng = np.random.default_rng(2)
    doubt = judged(rng.normal(size=200), rng.uniform(0.1, 1.0, 200))
    assert (np.diff(doubt.widen(np.linspace(0.0, 3.0, 20))) > 0.0).all()


def test_a_spread_is_taken_as_stated_while_few_were_asked():
    spreads = np.array([0.3, 2.0])
    np.testing.assert_array_equal(judged([9.0] * 10, [1.0] * 10).widen(spreads), spreads)


def test_unknown_spreads_count_as_none():
    doubt = judged(np.linspace(-1.0, 1.0, 100), np.full(100, np.nan))
    assert np.isfinite(doubt.widen(np.array([np.nan, 1.0]))).all()


def test_restored_it_corrects_as_before():
    rng = np.random.default_rng(3)
    doubt, again = judged(rng.normal(size=90), rng.uniform(0.1, 1.0, 90)), Doubt()
    again.restore(doubt.state())
    spreads = np.linspace(0.1, 2.0, 9)
    np.testing.assert_array_equal(doubt.widen(spreads), again.widen(spreads))
    again.restore({})
    np.testing.assert_array_equal(again.widen(spreads), spreads)


def test_witnesses_have_learned_nothing_for_a_while():
    doubt, model = Doubt(), KNNRegressor(n_neighbors=1)
    model.partial_fit(np.zeros((1, 2)), np.zeros(1))
    newest_known = []
    for frame in range(1, 5 * STRETCH_FRAMES):
        witness = doubt.witness(model)
        if witness is not None:
            newest_known.append(frame - witness.predict(np.full((1, 2), 1e6, np.float32))[0])
        model.partial_fit(np.full((1, 2), frame, np.float32), np.array([float(frame)]))
    assert min(newest_known) >= STRETCH_FRAMES
    assert max(newest_known) <= 2 * STRETCH_FRAMES + 4
