"""Views that were never taken carry the disparity that a nearer camera would have measured."""

import numpy as np
import pytest

from companion.vision import gradients
from companion.vision.views import MOST_ZOOM, views_of

IMAGE = np.tile(np.arange(128, dtype=np.uint8), (96, 1))
EVERYWHERE = np.full((96, 128), 3.0, np.float32)


def views(map_px=EVERYWHERE, n_views=40, seed=1, image=IMAGE):
    return views_of(image, map_px, 3.0, n_views, np.random.default_rng(seed))


def test_the_first_is_the_image_mirrored_with_its_own_label():
    first = views()[0]
    assert first.disparity_px == 3.0
    np.testing.assert_array_equal(first.view, gradients.shrink(IMAGE)[:, ::-1])


def test_a_part_enlarged_carries_as_many_times_the_disparity():
    """The ramp's slope tells how far a view was enlarged."""
    for sample in views()[1:]:
        slope = np.polyfit(np.arange(64), sample.view.mean(axis=0), 1)[0]
        zoom = 2.0 / abs(slope)
        assert sample.disparity_px == pytest.approx(3.0 * zoom, rel=0.05)
        assert 3.0 <= sample.disparity_px <= 3.1 * MOST_ZOOM


def test_labels_come_from_the_part_shown():
    halves = EVERYWHERE.copy()
    halves[:, 64:] = 9.0
    dark_left = np.where(halves > 5.0, 200, 50).astype(np.uint8)
    for sample in views(halves, image=dark_left)[1:]:
        share = np.clip((sample.view.mean() - 50.0) / 150.0, 0.0, 1.0)
        per_zoom = 3.0 + 6.0 * share
        assert 0.9 * per_zoom < sample.disparity_px < 1.1 * MOST_ZOOM * per_zoom


def test_parts_that_stereo_did_not_match_are_left_out():
    assert len(views(np.full((96, 128), np.nan, np.float32))) == 1


def test_one_generator_one_set_of_views():
    for one, other in zip(views(seed=5), views(seed=5), strict=True):
        np.testing.assert_array_equal(one.view, other.view)
        assert one.disparity_px == other.disparity_px
