"""Gradient features keep place and size, and answer contrast with a shift."""

import numpy as np
import pytest

from companion.kernel.errors import PlanError
from companion.vision import gradients
from companion.vision.features import TextonFeatures, ViewFeatures
from companion.vision.textons import TextonDictionary, TextonSettings


def energies(image):
    """(SCALES, ENERGIES, ROWS, COLUMNS)."""
    features = gradients.encode(gradients.shrink(image))
    n_cells = gradients.ROWS * gradients.COLUMNS
    per_scale = gradients.ENERGIES * n_cells + len(gradients.QUANTILES)
    scales = features[:-n_cells].reshape(gradients.SCALES, per_scale)
    pooled = scales[:, : gradients.ENERGIES * n_cells]
    return pooled.reshape(gradients.SCALES, gradients.ENERGIES, gradients.ROWS, gradients.COLUMNS)


def stripes(period_px, shape=(96, 128)):
    columns = np.arange(shape[1]) // (period_px // 2) % 2
    return np.tile(80 + 90 * columns, (shape[0], 1)).astype(np.uint8)


def test_a_blank_image_has_no_energy_and_its_brightness():
    features = gradients.encode(gradients.shrink(np.full((96, 128), 128, np.uint8)))
    assert features.shape == (gradients.N_FEATURES,)
    np.testing.assert_allclose(features[:-12], np.log(gradients.FLOOR_LSB))
    np.testing.assert_allclose(features[-12:], 2.0)


def test_upright_stripes_are_seen_across_and_not_down():
    across, down = energies(stripes(16))[0, :2]
    assert across.min() > 3.0
    np.testing.assert_allclose(down, np.log(gradients.FLOOR_LSB))


def test_energy_stays_where_the_texture_is():
    image = np.full((96, 128), 100, np.uint8)
    image[:, :30] = stripes(8)[:, :30]
    across = energies(image)[0, 0]
    assert across[:, 0].min() > 3.0
    np.testing.assert_allclose(across[:, 2:], np.log(gradients.FLOOR_LSB))


def test_fine_texture_vanishes_at_coarse_scales_and_large_does_not():
    fine, large = energies(stripes(8))[:, 0].mean((1, 2)), energies(stripes(32))[:, 0].mean((1, 2))
    assert fine[2] < 0.5 * fine[0]
    assert large[2] > large[0]


def test_a_larger_camera_gives_nearly_the_same_features():
    small = stripes(16)
    large = np.kron(small, np.ones((5, 5), np.uint8))
    np.testing.assert_allclose(energies(large), energies(small), atol=0.05)


def test_gradients_are_ready_at_once_and_refuse_textons():
    extractor = ViewFeatures("gradients")
    assert extractor.observe(stripes(16), frozen=True) is not None
    with pytest.raises(PlanError, match="use no textons"):
        extractor.adopt(TextonDictionary(np.zeros((1, 25)), np.zeros((1, 25))))


def test_a_frozen_texton_extractor_learns_no_dictionary():
    settings = TextonSettings(training_images=1)
    extractor = TextonFeatures(settings, 0.1, np.random.default_rng(0))
    assert extractor.observe(stripes(16), frozen=True) is None
    assert not extractor.ready
    assert extractor.observe(stripes(16), frozen=False) is None
    assert extractor.ready
