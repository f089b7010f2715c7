"""ROC figures equal their definitions and scikit-learn's; what is undefined is NaN."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from sklearn.metrics import roc_auc_score

from companion.judging.performance import OnlinePerformance, roc_curve, threshold_for_tpr_px

THRESHOLD_PX = 4.0

# Few distinct values, so that ties are the rule.
pairs = st.lists(
    st.tuples(st.integers(0, 12).map(lambda n: n / 2), st.integers(0, 12).map(lambda n: n / 2)),
    min_size=2,
    max_size=60,
)


def split(samples):
    scores, labels = np.array(samples, dtype=float).T
    positive = labels > THRESHOLD_PX
    return scores, labels, positive


@given(pairs)
def test_auc_equals_scikit_learns(samples):
    scores, labels, positive = split(samples)
    assume(positive.any() and not positive.all())
    expected = roc_auc_score(positive, scores)
    assert roc_curve(scores, labels, THRESHOLD_PX).auc == pytest.approx(expected, abs=1e-12)


@given(pairs)
def test_each_threshold_gives_the_rates_of_its_point(samples):
    scores, labels, positive = split(samples)
    assume(positive.any() and not positive.all())
    for fpr, tpr, threshold_px in zip(*roc_curve(scores, labels, THRESHOLD_PX), strict=True):
        detected = scores > threshold_px
        assert tpr == pytest.approx(detected[positive].mean())
        assert fpr == pytest.approx(detected[~positive].mean())


@given(pairs, st.floats(0.05, 1.0))
def test_wanted_tpr_costs_the_lowest_fpr_that_any_threshold_offers(samples, wanted_tpr):
    scores, labels, positive = split(samples)
    assume(positive.any() and not positive.all())
    possible = [
        (scores > cut)[~positive].mean()
        for cut in np.concatenate([[-1.0], scores])
        if (scores > cut)[positive].mean() >= wanted_tpr - 1e-12
    ]
    curve = roc_curve(scores, labels, THRESHOLD_PX)
    assert curve.fpr_at_tpr(wanted_tpr) == pytest.approx(min(possible))
    chosen_px = threshold_for_tpr_px(scores, labels, THRESHOLD_PX, wanted_tpr)
    assert (scores > chosen_px)[positive].mean() >= wanted_tpr - 1e-12


def test_perfect_scores_need_no_false_positive():
    labels = np.linspace(0.0, 8.0, 50)
    curve = roc_curve(labels, labels, THRESHOLD_PX)
    assert curve.auc == 1.0
    assert curve.fpr_at_tpr(1.0) == 0.0
    assert 3.8 < curve.threshold_at_tpr_px(1.0) < 4.2


@pytest.mark.parametrize("labels", [[1.0, 2.0], [5.0, 6.0], []])
def test_without_positives_or_negatives_auc_is_nan(labels):
    curve = roc_curve(labels, labels, THRESHOLD_PX)
    assert math.isnan(curve.auc)
    assert math.isnan(curve.fpr_at_tpr(0.96))


def test_without_positives_there_is_no_threshold():
    assert math.isnan(threshold_for_tpr_px([1.0, 2.0], [1.0, 2.0], THRESHOLD_PX, 0.96))


def test_without_negatives_the_threshold_still_reaches_the_wanted_tpr():
    assert threshold_for_tpr_px([1.0, 2.0], [5.0, 6.0], THRESHOLD_PX, 1.0) < 1.0


def test_pairs_with_nan_do_not_count():
    scores, labels = [1.0, math.nan, 9.0, 5.0, 2.0], [1.0, 9.0, math.nan, 6.0, 7.0]
    with_nan = roc_curve(scores, labels, THRESHOLD_PX)
    without = roc_curve([1.0, 5.0, 2.0], [1.0, 6.0, 7.0], THRESHOLD_PX)
    assert with_nan.auc == without.auc


def test_running_figures_equal_those_of_the_whole():
    rng = np.random.default_rng(0)
    labels = rng.uniform(0, 8, 500)
    estimates = labels + rng.normal(0, 1, 500)
    labels[::7] = np.nan
    estimates[::11] = np.nan
    online = OnlinePerformance(THRESHOLD_PX)
    for estimate, label in zip(estimates, labels, strict=True):
        online.update(estimate, label, 3.5)
    known = ~np.isnan(estimates + labels)
    estimates, labels = estimates[known], labels[known]
    detected, positive = estimates > 3.5, labels > THRESHOLD_PX
    assert online.n_samples == known.sum()
    assert online.mse_px2 == pytest.approx(np.mean((estimates - labels) ** 2))
    assert online.mse_over_variance == pytest.approx(online.mse_px2 / labels.var())
    assert online.tpr == pytest.approx(detected[positive].mean())
    assert online.fpr == pytest.approx(detected[~positive].mean())


def test_before_the_first_sample_all_figures_are_nan():
    online = OnlinePerformance(THRESHOLD_PX)
    figures = (online.mse_px2, online.mse_over_variance, online.tpr, online.fpr)
    assert all(math.isnan(figure) for figure in figures)
