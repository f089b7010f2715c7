"""The convolutional network: the contract, and a clear word where PyTorch is missing."""

import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from companion.kernel.errors import PlanError
from companion.kernel.settings import convert_settings
from companion.learning.learner import Learner
from companion.learning.learner_settings import LearnerSettings
from companion.regressors import RegressorSettings, make


def settings(**table):
    return convert_settings(table, LearnerSettings, "plan.toml: learner")


def test_without_pytorch_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "companion.regressors.cnn", raising=False)
    with pytest.raises(PlanError, match=r'"cnn" needs PyTorch.*extra "deep"') as caught:
        Learner(settings(regressor="cnn"), np.random.default_rng(0))
    assert "\n" not in str(caught.value)


def test_it_brings_its_features_with_it_under_the_papers_preset_too():
    assert settings(regressor="cnn").design == ("pixels", "cnn", "linear", 0, False)
    assert settings(preset="best", regressor="cnn").design == ("pixels", "cnn", "log", 5, True)
    with pytest.raises(PlanError, match='regressor "cnn" needs features = "pixels"'):
        settings(preset="none", regressor="cnn", features="textons")
    with pytest.raises(PlanError, match='features = pixels contradicts preset "paper"'):
        settings(features="pixels")


@pytest.fixture(scope="module")
def cnn():
    pytest.importorskip("torch", reason='the extra "deep" is not installed')
    from companion.regressors import cnn

    return cnn


@pytest.fixture(scope="module")
def planted():
    """Stripes (24 x 32), the wider the nearer."""
    rng = np.random.default_rng(2)
    y = rng.uniform(1.0, 6.0, 120)
    columns = np.arange(32) + rng.uniform(0, 30, (120, 1))
    rows = 128 + 80 * np.sign(np.sin(columns * (3.0 / y[:, np.newaxis])))
    images = rows[:, np.newaxis, :] + rng.normal(0, 4, (120, 24, 32))
    return images.reshape(120, -1).astype(np.float32), y


def small(cnn, **changes):
    return cnn.CNNRegressor(**{"height": 24, "width": 32, "random_state": 3, **changes})


@pytest.fixture(scope="module")
def taught(cnn, planted):
    X, y = planted
    model = small(cnn, n_steps=3)
    for row in range(100):
        model.partial_fit(X[row : row + 1], y[row : row + 1])
    return model


def test_it_learns_a_planted_relation_online_and_states_its_error(taught, planted):
    X, y = planted
    mean, std = taught.predict(X[100:], return_std=True)
    assert np.mean((mean - y[100:]) ** 2) < 0.4 * y.var()
    assert (std > 0.0).all()
    assert np.mean(np.abs(mean - y[100:]) < 2.0 * std) > 0.8


def test_restored_it_predicts_and_learns_on_to_the_bit(cnn, taught, planted):
    X, y = planted
    models = [small(cnn, n_steps=3).restore(taught.state()) for _ in range(2)]
    models.append(taught.snapshot())
    for model in models:
        model.partial_fit(X[100:104], y[100:104])
    first, *others = [model.predict(X[:20], return_std=True) for model in models]
    for other in others:
        assert_array_equal(other, first)


def test_a_snapshot_does_not_learn_on(cnn, taught, planted):
    X, y = planted
    model = small(cnn).restore(taught.state())
    snapshot = model.snapshot()
    before = snapshot.predict(X[:5])
    model.partial_fit(X[:8], y[:8] + 50.0)
    assert_array_equal(snapshot.predict(X[:5]), before)
    assert not np.array_equal(model.predict(X[:5]), before)


def test_it_remembers_the_newest_images_only_also_when_restored(cnn, planted):
    X, y = planted
    model = small(cnn, capacity=16)
    for start in range(0, 40, 4):
        model.partial_fit(X[start : start + 4], y[start : start + 4])
    assert_array_equal(model.state()["y"], y[24:40])
    restored = small(cnn, capacity=16).restore(model.state())
    for one in (model, restored):
        one.partial_fit(X[40:43], y[40:43])
    assert_array_equal(restored.state()["X"], model.state()["X"])
    assert_allclose(restored.predict(X[:5]), model.predict(X[:5]), rtol=0, atol=0)


def test_images_of_another_size_are_refused(cnn):
    with pytest.raises(ValueError, match="images of 32 x 24 have 768"):
        small(cnn).partial_fit(np.zeros((1, 100), np.float32), [1.0])


def test_the_network_is_that_of_the_appendix(cnn):
    layers = list(cnn.make_network(48, 64, np.random.default_rng(0)))
    kinds = [type(layer).__name__ for layer in layers]
    assert kinds.count("Conv2d") == 3
    convolutions = [layer for layer in layers if type(layer).__name__ == "Conv2d"]
    assert [(c.out_channels, c.kernel_size) for c in convolutions] == [
        (32, (5, 5)), (32, (5, 5)), (128, (5, 5))
    ]  # fmt: skip
    assert kinds.count("MaxPool2d") == 1
    assert kinds.count("AvgPool2d") == 2
    assert kinds.count("LocalResponseNorm") == 2
    assert kinds.count("Linear") == 2


def test_a_learner_flies_with_it_and_with_enlarged_views(cnn):
    rng = np.random.default_rng(0)
    learner = Learner(settings(preset="best", regressor="cnn"), np.random.default_rng(1))
    for disparity_px in (2.0, 4.0):
        image = rng.integers(0, 256, (96, 128)).astype(np.uint8)
        features = learner.observe(image)
        assert learner.learn(features, disparity_px, lambda: np.full((96, 128), 3.0, np.float32))
    assert 2.0 <= learner.predict(features).mono_px <= 4.0
    assert make("cnn", RegressorSettings()).state() == {}
