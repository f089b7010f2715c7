"""Ridge, Gaussian process and networks: one contract, planted truths."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.exceptions import NotFittedError
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF
from sklearn.linear_model import Ridge
from sklearn.utils.estimator_checks import parametrize_with_checks

from companion.regressors import (
    REGRESSORS,
    GPRegressor,
    MeanRegressor,
    MLPRegressor,
    RegressorSettings,
    RidgeRegressor,
    make,
)
from companion.regressors.scaling import Rarity, RunningScale

NAMES = sorted(set(REGRESSORS) - {"cnn"})
"""cnn sees images only, and has tests of its own."""


@parametrize_with_checks([RidgeRegressor(), GPRegressor(), MLPRegressor(), MeanRegressor()])
def test_keeps_scikit_learns_contract(estimator, check):
    check(estimator)


@pytest.fixture(scope="module")
def planted():
    """A smooth function of two of six features, with noise of 0.1."""
    rng = np.random.default_rng(3)
    X = rng.normal(size=(400, 6)).astype(np.float32)
    y = 3.0 + X[:, 0] + np.abs(X[:, 1]) + rng.normal(0.0, 0.1, 400)
    return X, y


def taught(name, X, y, rows=4):
    model = make(name, RegressorSettings(seed=7))
    for start in range(0, len(y), rows):
        model.partial_fit(X[start : start + rows], y[start : start + rows])
    return model


@pytest.mark.parametrize(
    ("name", "limit"), [("ridge", 0.5), ("gp", 0.2), ("mlp", 0.4), ("blend", 0.5)]
)
def test_finds_a_planted_relation_and_states_its_error(planted, name, limit):
    X, y = planted
    mean, std = taught(name, X[:300], y[:300], rows=1).predict(X[300:], return_std=True)
    error = mean - y[300:]
    assert np.mean(error**2) < limit * y.var()
    assert (std > 0.0).all()
    assert np.mean(np.abs(error) < 2.0 * std) > 0.8


@pytest.mark.parametrize("name", ["blend", "gp", "mlp"])
def test_far_from_all_samples_the_spread_is_wider(planted, name):
    X, y = planted
    model = taught(name, X, y)
    near, far = (model.predict(X[:50] * reach, return_std=True)[1].mean() for reach in (1.0, 4.0))
    assert far > 1.2 * near


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        *((name, RegressorSettings(seed=7)) for name in NAMES),
        *((name, RegressorSettings(seed=7, capacity=60, keep="mixed")) for name in ("knn", "mlp")),
    ],
)
def test_a_restored_model_predicts_and_learns_on_to_the_bit(planted, name, settings):
    X, y = planted
    original = make(name, settings)
    for row in range(0, 200, 5):
        original.partial_fit(X[row : row + 5], y[row : row + 5])
    restored = make(name, settings).restore(original.state())
    for model in (original, restored):
        model.partial_fit(X[200:210], y[200:210])
    for one, other in zip(
        original.predict(X[:20], return_std=True),
        restored.predict(X[:20], return_std=True),
        strict=True,
    ):
        assert_array_equal(one, other)


@pytest.mark.parametrize("name", NAMES)
def test_a_snapshot_does_not_learn_on(planted, name):
    X, y = planted
    model = taught(name, X[:100], y[:100])
    snapshot = model.snapshot()
    before = snapshot.predict(X[:20])
    model.partial_fit(X[100:120], y[100:120] + 50.0)
    assert_array_equal(snapshot.predict(X[:20]), before)


@pytest.mark.parametrize("name", NAMES)
def test_an_untrained_model_has_no_state_and_predicts_nothing(name):
    model = make(name, RegressorSettings())
    assert model.state() == {}
    assert make(name, RegressorSettings()).restore({}).state() == {}
    with pytest.raises(NotFittedError):
        model.predict(np.zeros((1, 3), dtype=np.float32))


def test_ridge_in_any_pieces_equals_ridge_at_once(planted):
    X, y = planted
    scaled = (X - X.mean(axis=0)) / X.std(axis=0)
    expected = Ridge(alpha=1.0).fit(scaled.astype(float), y).predict(scaled)
    assert_allclose(RidgeRegressor().fit(X, y).predict(X), expected, rtol=1e-5)
    assert_allclose(taught("ridge", X, y, rows=7).predict(X), expected, rtol=1e-5)


def test_gaussian_process_equals_scikit_learns(planted):
    X, y = planted[0][:60], planted[1][:60]
    scaled = (X - X.mean(axis=0)) / X.std(axis=0)
    theirs = GaussianProcessRegressor(RBF(np.sqrt(6.0)), alpha=0.09, optimizer=None)
    expected = theirs.fit(scaled.astype(float), (y - y.mean()) / y.std()).predict(scaled)
    assert_allclose(GPRegressor().fit(X, y).predict(X), expected * y.std() + y.mean(), rtol=1e-4)


def test_a_window_forgets(planted):
    X, y = planted
    forgetful = GPRegressor(window=50).fit(X, y)
    assert_array_equal(forgetful.predict(X[:9]), GPRegressor().fit(X[-50:], y[-50:]).predict(X[:9]))


def test_networks_remember_the_newest_samples_only(planted):
    X, y = planted
    model = MLPRegressor(capacity=64)
    for start in range(0, 200, 10):
        model.partial_fit(X[start : start + 10], y[start : start + 10])
    assert_array_equal(model.state()["y"], y[136:200])


def test_rare_targets_are_learned_too():
    """One in fifty is near; least squares alone would answer the many."""
    rng = np.random.default_rng(5)
    y = np.where(rng.random(1000) < 0.02, 5.0, 1.0)
    X = (y[:, np.newaxis] + rng.normal(0.0, 0.5, (1000, 4))).astype(np.float32)
    model = taught("mlp", X, y)
    assert model.predict(np.full((1, 4), 5.0, np.float32))[0] > 4.0


def test_running_scale_equals_that_of_all_rows():
    rows = np.random.default_rng(1).normal(3.0, 2.0, (100, 5))
    rows[:, 4] = 7.0
    scale = RunningScale(5)
    for part in np.split(rows, [1, 30, 31, 90]):
        scale.update(part)
    assert_allclose(scale.apply(rows)[:, :4].mean(axis=0), 0.0, atol=1e-6)
    assert_allclose(scale.apply(rows)[:, :4].std(axis=0), 1.0, rtol=1e-5)
    assert_allclose(scale.apply(rows)[:, 4], 0.0, atol=1e-6)


def test_rarity_is_a_share_and_balances_a_ridge():
    """Ten samples know how the near grow, a thousand say nothing of it."""
    rarity = Rarity()
    many, few = np.full(900, 1.0), np.full(100, 5.0)
    rarity.weights(many, 1.0)
    assert_allclose(rarity.weights(few, 1.0), 1.0 / (0.1 + 0.01))
    rng = np.random.default_rng(2)
    y = np.where(rng.random(2000) < 0.02, 5.0, 1.0)
    X = (y[:, np.newaxis] + rng.normal(0.0, 2.0, (2000, 4))).astype(np.float32)
    plain, balanced = (
        RidgeRegressor(balance=power).fit(X, y).predict(X[y > 3.0]).mean() for power in (0.0, 1.0)
    )
    assert plain + 1.0 < balanced < 5.5


def test_the_mean_is_the_mean_of_all_it_saw(planted):
    X, y = planted
    mean, std = taught("mean", X, y, rows=7).predict(X[:3], return_std=True)
    assert_allclose(mean, y.mean())
    assert_allclose(std, y.std())
