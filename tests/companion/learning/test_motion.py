"""What nearness is worth in pixels: planted ratios found again, and who is believed."""

import math

import numpy as np
import pytest

from companion.kernel.settings import convert_settings
from companion.learning.fusion import UNKNOWN, Estimate
from companion.learning.learner import Learner
from companion.learning.learner_settings import LearnerSettings
from companion.learning.motion import LEAST_SAMPLES, MotionScale, reconcile

RATIO_PX_M = 7.3


def taught(n_samples=400, scatter=0.06, ratio_px_m=RATIO_PX_M, scale=None, seed=1):
    rng = np.random.default_rng(seed)
    scale = MotionScale() if scale is None else scale
    for nearness_per_m in rng.uniform(0.1, 0.6, n_samples):
        factor = math.exp(scatter * rng.standard_normal())
        scale.learn(nearness_per_m, ratio_px_m * nearness_per_m * factor)
    return scale


def test_the_ratio_and_its_scatter_are_found():
    estimate = taught().estimate(0.4)
    assert estimate.disparity_px == pytest.approx(0.4 * RATIO_PX_M, rel=0.01)
    assert estimate.std_px == pytest.approx(0.06 * 0.4 * RATIO_PX_M, rel=0.25)


def test_a_fifth_of_wild_samples_moves_it_little():
    rng = np.random.default_rng(2)
    scale = taught(scatter=0.03)
    for _ in range(100):
        scale.learn(rng.uniform(0.05, 0.6), rng.uniform(0.5, 30.0))
    assert scale.estimate(0.4).disparity_px == pytest.approx(0.4 * RATIO_PX_M, rel=0.03)


def test_it_follows_when_speed_is_told_differently():
    scale = taught()
    taught(2000, ratio_px_m=5.0, scale=scale)
    assert scale.estimate(0.4).disparity_px == pytest.approx(2.0, rel=0.02)


def test_before_it_has_seen_enough_and_without_motion_it_says_nothing():
    assert math.isnan(taught(LEAST_SAMPLES - 1).estimate(0.4).disparity_px)
    assert math.isfinite(taught(LEAST_SAMPLES).estimate(0.4).disparity_px)
    assert math.isnan(taught().estimate(math.nan).disparity_px)


@pytest.mark.parametrize("sample", [(math.nan, 2.0), (0.01, 2.0), (0.4, 0.1), (0.4, math.nan)])
def test_what_tells_nothing_of_the_ratio_is_not_learned(sample):
    scale = MotionScale()
    for _ in range(2 * LEAST_SAMPLES):
        scale.learn(*sample)
    assert math.isnan(scale.estimate(0.4).disparity_px)


def test_restored_it_answers_as_before():
    scale, again = taught(), MotionScale()
    again.restore(scale.state())
    assert again.estimate(0.3) == pytest.approx(scale.estimate(0.3))
    again.restore({})
    assert math.isnan(again.estimate(0.3).disparity_px)


def test_who_agree_are_weighed_and_who_contradict_are_not():
    near, far = Estimate(3.0, 0.1), Estimate(2.0, 0.2)
    assert reconcile(near, far) == near
    assert reconcile(far, near) == near
    both = reconcile(Estimate(2.5, 0.3), Estimate(2.2, 0.3))
    assert both.disparity_px == pytest.approx(2.35)
    assert both.std_px < 0.3
    assert reconcile(near, UNKNOWN) == near
    assert reconcile(UNKNOWN, near) == near


def learner(**table):
    table = {"preset": "best", "smooth_frames": 1, **table}
    settings = convert_settings(table, LearnerSettings, "plan.toml: learner")
    return Learner(settings, np.random.default_rng(0))


def test_a_learner_that_moves_estimates_what_its_images_do_not_tell():
    """The image is the same whatever λ is: appearance can only answer the mean."""
    rng, taught_one = np.random.default_rng(3), learner()
    image = rng.integers(0, 256, (96, 128), dtype=np.uint8)
    disparities_px = rng.uniform(1.0, 4.0, 200)
    for disparity_px in disparities_px:
        taught_one.learn(taught_one.observe(image, disparity_px / RATIO_PX_M), disparity_px)
    for disparity_px in (1.5, 3.5):
        moving = taught_one.predict(taught_one.observe(image, disparity_px / RATIO_PX_M))
        assert moving.mono_px == pytest.approx(disparity_px, abs=0.1)
        assert moving.motion_px == pytest.approx(disparity_px, rel=0.01)
    hovering = taught_one.predict(taught_one.observe(image))
    assert hovering.mono_px == pytest.approx(disparities_px.mean(), abs=0.3)
    assert hovering.std_px > 3.0 * moving.std_px
    assert math.isnan(hovering.motion_px)
