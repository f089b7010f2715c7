"""kNN is exact, incremental, bounded, and keeps scikit-learn's contract."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.exceptions import NotFittedError
from sklearn.neighbors import KNeighborsRegressor
from sklearn.utils.estimator_checks import parametrize_with_checks

from companion import regressors
from companion.kernel.errors import PlanError
from companion.regressors import KNNRegressor, RegressorSettings


@pytest.fixture
def samples():
    rng = np.random.default_rng(3)
    return rng.random((700, 21), dtype=np.float32), rng.random(700)


@parametrize_with_checks([KNNRegressor(n_neighbors=3, capacity=1000)])
def test_keeps_scikit_learns_contract(estimator, check):
    check(estimator)


def test_equals_an_exhaustive_search(samples):
    X, y = samples
    queries = np.random.default_rng(4).random((100, 21), dtype=np.float32)
    expected = KNeighborsRegressor(5, algorithm="brute").fit(X.astype(float), y)
    assert_allclose(KNNRegressor(5).fit(X, y).predict(queries), expected.predict(queries))


@settings(max_examples=40)
@given(cuts=st.lists(st.integers(0, 700), max_size=8))
def test_learning_in_pieces_equals_learning_at_once(cuts):
    rng = np.random.default_rng(3)
    X, y = rng.random((700, 4), dtype=np.float32), rng.random(700)
    bounds = sorted({0, 700, *cuts})
    grown = KNNRegressor()
    for start, stop in pairwise(bounds):
        grown.partial_fit(X[start:stop], y[start:stop])
    assert_array_equal(grown.predict(X[:50]), KNNRegressor().fit(X, y).predict(X[:50]))


@pytest.mark.parametrize("step", [1, 7, 300])
def test_beyond_its_capacity_it_knows_the_newest_samples_only(samples, step):
    X, y = samples
    ring = KNNRegressor(n_neighbors=5, capacity=200)
    for start in range(0, 700, step):
        ring.partial_fit(X[start : start + step], y[start : start + step])
    newest = KNNRegressor(n_neighbors=5).fit(X[-200:], y[-200:])
    assert ring.memory_.n_kept == 200
    assert_allclose(ring.predict(X[:100]), newest.predict(X[:100]))


@pytest.mark.parametrize("capacity", [200, 3000])
def test_crowds_among_many_samples_lose_no_neighbour(capacity):
    """Tiles are halved, refilled and skipped; distances are the same with or without them."""
    rng = np.random.default_rng(6)
    centres = rng.random((12, 5), dtype=np.float32)
    X = np.repeat(centres, 300, axis=0) + rng.normal(0.0, 0.02, (3600, 5)).astype(np.float32)
    X = X[rng.permutation(3600)]
    y = rng.random(3600)
    model = KNNRegressor(n_neighbors=7, capacity=capacity)
    for start in range(0, 3600, 450):
        model.partial_fit(X[start : start + 450], y[start : start + 450])
    queries = rng.random((200, 5), dtype=np.float32)
    expected = KNeighborsRegressor(7, algorithm="brute").fit(X[-capacity:], y[-capacity:])
    assert_allclose(model.predict(queries), expected.predict(queries), rtol=1e-6)


def test_of_samples_equally_near_the_oldest_count():
    X = np.zeros((300, 3), dtype=np.float32)
    assert KNNRegressor(n_neighbors=2).fit(X, np.arange(300.0)).predict(X[:1])[0] == 0.5


def test_spread_is_the_standard_deviation_of_the_neighbours_targets():
    X = np.array([[0.0], [1.0], [2.0], [50.0]], dtype=np.float32)
    model = KNNRegressor(n_neighbors=3).fit(X, [1.0, 2.0, 6.0, 99.0])
    mean, std = model.predict(np.array([[1.1]], dtype=np.float32), return_std=True)
    assert mean[0] == pytest.approx(3.0)
    assert std[0] == pytest.approx(np.std([1.0, 2.0, 6.0], ddof=1))


def test_fewer_samples_than_neighbours_are_all_used():
    model = KNNRegressor(n_neighbors=5).fit(np.array([[0.0], [1.0]]), [2.0, 4.0])
    assert model.predict(np.array([[7.0]]))[0] == 3.0


def test_spread_of_one_neighbour_is_unknown():
    model = KNNRegressor(n_neighbors=5).fit(np.array([[0.0]]), [2.0])
    assert np.isnan(model.predict(np.array([[7.0]]), return_std=True)[1][0])


def test_a_snapshot_does_not_learn_on(samples):
    X, y = samples
    model = KNNRegressor().fit(X[:300], y[:300])
    snapshot = model.snapshot()
    before = model.predict(X[:20])
    model.partial_fit(X, y + 100.0)
    assert_array_equal(snapshot.predict(X[:20]), before)
    assert not np.array_equal(model.predict(X[:20]), before)


@pytest.mark.parametrize("n_samples", [0, 50, 130, 500])
def test_restored_state_predicts_and_forgets_as_the_original(samples, n_samples):
    X, y = samples
    original = KNNRegressor(capacity=128)
    if n_samples:
        original.partial_fit(X[:n_samples], y[:n_samples])
    restored = KNNRegressor(capacity=128).restore(original.state())
    for model in (original, restored):
        model.partial_fit(X[500:600], y[500:600])
    assert_array_equal(original.predict(X[:50]), restored.predict(X[:50]))


def test_predicting_before_learning_is_an_error():
    with pytest.raises(NotFittedError):
        KNNRegressor().predict(np.zeros((1, 3), dtype=np.float32))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_unknown_features_are_refused_on_the_fast_path_too(samples, bad):
    X, y = samples
    model = KNNRegressor().fit(X, y)
    query = X[:1].copy()
    query[0, 3] = bad
    with pytest.raises(ValueError, match=r"NaN|infinity"):
        model.predict(query)
    with pytest.raises(ValueError, match=r"NaN|infinity"):
        model.partial_fit(X[:1], np.array([bad]))


def test_regressors_are_made_by_name():
    model = regressors.make("knn", RegressorSettings(k=3, capacity=10))
    assert isinstance(model, KNNRegressor)
    assert (model.n_neighbors, model.capacity) == (3, 10)


def test_an_unknown_name_is_answered_with_the_allowed_ones():
    with pytest.raises(PlanError, match=r"no such regressor 'oracle'; allowed: .*knn"):
        regressors.make("oracle", RegressorSettings())
