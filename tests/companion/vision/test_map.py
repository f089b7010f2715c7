"""A map of λ: labelled from stereo's map, learned per cell, and flown by."""

import math

import numpy as np
import pytest

from companion.kernel.errors import PlanError
from companion.kernel.settings import convert_settings
from companion.learning.learner import Learner
from companion.learning.learner_settings import LearnerSettings
from companion.plan import load_plan
from companion.vision.cells import CELLS, COLUMNS, ROWS, cell_labels, freer_side


def settings(**table):
    table = {"preset": "best", "output": "map", "smooth_frames": 1, **table}
    return convert_settings(table, LearnerSettings, "plan.toml: learner")


def scene(left_px, right_px, rng):
    """A wall of tiles, the larger the nearer, left and right: image and map, (96, 128)."""
    halves = []
    for disparity_px in (left_px, right_px):
        tile_px = max(2, round(2.0 * disparity_px))
        shape = 96 // tile_px + 2, 64 // tile_px + 2
        tiles = np.kron(rng.integers(40, 216, shape), np.ones((tile_px, tile_px)))
        halves.append(tiles[:96, :64])
    map_px = np.full((96, 128), left_px, np.float32)
    map_px[:, 64:] = right_px
    return np.hstack(halves).astype(np.uint8), map_px


def taught(learner, n_frames=150, seed=1):
    rng = np.random.default_rng(seed)
    for _ in range(n_frames):
        image, map_px = scene(*rng.uniform(1.0, 10.0, 2), rng)
        learner.learn(learner.observe(image), float(map_px.mean()), lambda map_px=map_px: map_px)
    return learner


@pytest.fixture(scope="module", params=["best", "none"])
def learned(request):
    table = {"textons": {"training_images": 20}} if request.param == "none" else {}
    return taught(Learner(settings(preset=request.param, **table), np.random.default_rng(0)))


def test_a_cell_is_the_mean_of_its_matches_and_unknown_with_few():
    map_px = np.full((96, 128), np.nan, np.float32)
    map_px[:16, :16] = np.where(np.arange(16) < 8, 2.0, 4.0)
    map_px[16:18, :16] = 5.0
    labels = cell_labels(map_px)
    assert labels.disparity_px.shape == (ROWS, COLUMNS)
    assert labels.disparity_px[0, 0] == 3.0
    assert np.isnan(labels.disparity_px[1, 0])
    assert labels.valid_norm[1, 0] == pytest.approx(2 / 16)
    assert np.isnan(labels.disparity_px).sum() == CELLS - 1


@pytest.mark.parametrize("shape", [(96, 128), (100, 131), (480, 640)])
def test_cells_cover_images_of_any_size(shape):
    columns = np.broadcast_to(np.arange(shape[1], dtype=np.float32), shape)
    labels = cell_labels(columns)
    assert labels.disparity_px.mean() == pytest.approx((shape[1] - 1) / 2, rel=0.01)
    assert (np.diff(labels.disparity_px, axis=1) > 0.0).all()


def test_the_freer_side_is_the_farther_one():
    near_left = np.array([[6.0, 5.0, np.nan, 1.0]], np.float32)
    assert freer_side(near_left) == 1
    assert freer_side(near_left[:, ::-1]) == -1
    assert freer_side(np.full((2, 4), np.nan, np.float32)) == 0


def test_it_learns_which_side_is_near(learned):
    rng = np.random.default_rng(7)
    for left_px, right_px in ((2.0, 8.0), (8.0, 2.0)) * 5:
        estimate = learned.predict(learned.observe(scene(left_px, right_px, rng)[0]))
        assert estimate.map_px.shape == (ROWS, COLUMNS)
        assert freer_side(estimate.map_px) == (1 if left_px > right_px else -1)


def test_the_images_disparity_is_the_mean_of_its_cells(learned):
    rng = np.random.default_rng(8)
    for disparity_px in (2.0, 4.0, 8.0):
        estimate = learned.predict(learned.observe(scene(disparity_px, disparity_px, rng)[0]))
        assert estimate.mono_px == pytest.approx(float(estimate.map_px.mean()), rel=0.01)
        assert estimate.mono_px == pytest.approx(disparity_px, rel=0.5)
        assert 0.0 < estimate.std_px < 10.0


def test_restored_it_draws_the_same_map(learned):
    again = Learner(learned.settings, np.random.default_rng(5)).restore(learned.state())
    image = scene(3.0, 6.0, np.random.default_rng(9))[0]
    one, other = (learner.predict(learner.observe(image)) for learner in (learned, again))
    np.testing.assert_array_equal(one.map_px, other.map_px)
    assert one[:3] == other[:3]


def test_unmatched_cells_and_missing_maps_teach_nothing():
    learner = Learner(settings(), np.random.default_rng(0))
    image, map_px = scene(3.0, 6.0, np.random.default_rng(9))
    assert not learner.learn(learner.observe(image), 4.5)
    assert not learner.learn(learner.observe(image), 4.5, lambda: np.full_like(map_px, np.nan))
    assert math.isnan(learner.predict(learner.observe(image)).mono_px)
    map_px[:, :96] = np.nan
    assert learner.learn(learner.observe(image), 4.5, lambda: map_px)
    assert learner.predict(learner.observe(image)).mono_px == pytest.approx(6.0)


def test_turning_to_the_freer_side_needs_a_map():
    freer = "behaviour.turn_to=freer"
    assert load_plan(None, [freer, "learner.output=map"]).behaviour.turn_to == "freer"
    with pytest.raises(PlanError, match=r'"freer" needs learner\.output = "map"'):
        load_plan(None, [freer])
