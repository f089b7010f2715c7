"""The preset that estimates best: learns log λ from views never taken, keeps it, repeats it."""

import math
from pathlib import Path

import numpy as np
import pytest

from companion.camera.recording import open_recordings
from companion.kernel.calibration import Intrinsics, StereoCalibration
from companion.kernel.errors import PlanError
from companion.kernel.settings import convert_settings
from companion.learn import Session
from companion.learning.learner import Learner
from companion.learning.learner_settings import LearnerSettings
from companion.modelfile import load_model, save_model
from companion.plan import load_plan

EYE = Intrinsics(120.0, 120.0, 64.0, 48.0)
CALIBRATION = StereoCalibration(128, 96, EYE, EYE, baseline_m=0.06)

PAPER = {"preset": "paper", "smooth_frames": 4}


def best(**table):
    table = {"preset": "best", "smooth_frames": 1, **table}
    return convert_settings(table, LearnerSettings, "plan.toml: learner")


def view(disparity_px, rng):
    """A wall of painted tiles, the larger the nearer: (96, 128)."""
    tile_px = max(2, round(2.0 * disparity_px))
    shape = 96 // tile_px + 2, 128 // tile_px + 2
    tiles = np.kron(rng.integers(40, 216, shape), np.ones((tile_px, tile_px)))
    top, left = rng.integers(0, tile_px, 2)
    return tiles[top : top + 96, left : left + 128].astype(np.uint8)


def flat_map(disparity_px):
    return lambda: np.full((96, 128), disparity_px, np.float32)


def taught(learner, most_px=12.0, n_frames=250, seed=1, maps=True):
    rng = np.random.default_rng(seed)
    for disparity_px in rng.uniform(1.0, most_px, n_frames):
        features = learner.observe(view(disparity_px, rng))
        learner.learn(features, disparity_px, flat_map(disparity_px) if maps else None)
    return learner


def estimates(learner, disparities_px, seed=9):
    rng = np.random.default_rng(seed)
    views = [view(disparity_px, rng) for disparity_px in disparities_px]
    return np.array([learner.predict(learner.observe(image))[:2] for image in views])


@pytest.fixture(scope="module")
def learned():
    return taught(Learner(best(), np.random.default_rng(0)))


def test_it_learns_a_planted_relation_and_its_own_error(learned):
    truth_px = np.random.default_rng(8).uniform(1.0, 12.0, 100)
    mono_px, std_px = estimates(learned, truth_px).T
    error_px = np.abs(mono_px - truth_px)
    assert np.mean(error_px**2) < 0.15 * truth_px.var()
    assert 0.5 < np.mean(error_px < std_px) < 1.0


def test_it_estimates_from_the_second_frame_on():
    learner = Learner(best(), np.random.default_rng(0))
    assert learner.ready
    rng = np.random.default_rng(1)
    assert math.isnan(learner.predict(learner.observe(view(4.0, rng))).mono_px)
    learner.learn(learner.observe(view(4.0, rng)), 4.0, flat_map(4.0))
    assert learner.predict(learner.observe(view(4.0, rng))).mono_px == pytest.approx(4.0)


def test_enlarged_views_teach_what_was_never_near(learned):
    """Having seen half the range, it knows that the rest is nearer still."""
    far = np.linspace(1.0, 4.0, 40), np.full(40, 9.0)
    errors = []
    for maps in (True, False):
        learner = taught(Learner(best(), np.random.default_rng(0)), 4.0, maps=maps)
        learner.learn(learner.observe(view(9.0, np.random.default_rng(3))), 9.0)
        middle, near = (estimates(learner, values)[:, 0] for values in far)
        assert near.mean() > middle.max()
        errors.append(abs(near.mean() - 9.0))
    assert errors[0] < errors[1]


def test_estimates_stay_within_what_stereo_reported(learned):
    white = np.random.default_rng(2).integers(0, 256, (96, 128)).astype(np.uint8)
    for image in (white, np.zeros_like(white), np.full_like(white, 255)):
        assert 1.0 <= learned.predict(learned.observe(image)).mono_px <= 12.0


def test_negative_disparity_of_a_poor_calibration_is_learned_from():
    learner = Learner(best(), np.random.default_rng(0))
    rng = np.random.default_rng(1)
    for disparity_px in (-0.7, 0.5, 3.0):
        assert learner.learn(learner.observe(view(4.0, rng)), disparity_px, flat_map(disparity_px))
    assert math.isfinite(learner.predict(learner.observe(view(4.0, rng))).std_px)


def test_saved_and_restored_it_sees_the_same(tmp_path, learned):
    save_model(tmp_path / "model.npz", learned.state(), CALIBRATION)
    state = load_model(tmp_path / "model.npz", CALIBRATION).state
    restored = Learner(best(), np.random.default_rng(5)).restore(state)
    truth_px = [2.0, 5.0, 11.0]
    np.testing.assert_array_equal(estimates(restored, truth_px), estimates(learned, truth_px))


def test_frozen_it_learns_no_more():
    learner = taught(Learner(best(), np.random.default_rng(0)), n_frames=20)
    learner.freeze()
    before = learner.state().arrays
    taught(learner, n_frames=5, seed=5)
    for name, values in learner.state().arrays.items():
        np.testing.assert_array_equal(values, before[name])


def test_same_seed_same_learner():
    one, other = (taught(Learner(best(), np.random.default_rng(4)), n_frames=30) for _ in range(2))
    for name, values in one.state().arrays.items():
        np.testing.assert_array_equal(values, other.state().arrays[name])


def test_each_choice_of_the_preset_can_be_made_otherwise():
    assert best().design == ("gradients", "blend", "log", 5, True)
    chosen = best(regressor="knn", views=0, target="linear").design
    assert chosen == ("gradients", "knn", "linear", 0, True)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"features": "gradients", **PAPER}, 'contradicts preset "paper"'),
        ({"target": "log", **PAPER}, "target = log contradicts"),
        ({"motion": True, **PAPER}, "motion = True contradicts"),
        ({"preset": "none", "views": 3}, 'views must be 0 with features "textons"'),
        ({"dictionary": "model.npz"}, 'features "gradients" use no textons'),
    ],
)
def test_what_does_not_go_together_is_refused(table, message):
    with pytest.raises(PlanError, match=message):
        best(**table)


def test_a_model_of_the_papers_preset_is_refused(learned):
    paper = Learner(LearnerSettings(), np.random.default_rng(0))
    with pytest.raises(PlanError, match=r"learner\.features = 'gradients'; the plan says 'texton"):
        paper.restore(learned.state())


@pytest.fixture(scope="module")
def recorded(stereoboard):
    """Learned from every other take of a flight hall; and the report on the others."""
    takes = sorted(stereoboard.glob("board*"))[:14]
    session = Session(load_plan(None, ["learner.preset=best"]))
    session.run(open_recordings(takes[::2]))
    session.learner.freeze()
    session.forget_scores()
    session.run(open_recordings(takes[1::2]))
    return session, session.report(4.0, 4.0)


def test_on_recorded_flights_it_knows_near_from_far(recorded):
    report = recorded[1]
    assert report.auc > 0.96
    assert report.fpr_at_tpr_0_96 < 0.25
    assert report.mse_over_variance < 0.7


def test_on_recorded_flights_it_knows_how_far_to_trust_itself(recorded):
    report = recorded[1]
    assert 0.4 < report.coverage_0_5 < 0.9
    assert report.coverage_0_8 > 0.7
    assert report.coverage_0_95 > 0.85
    assert report.auc_of_error > 0.7


def test_the_hall_itself_is_not_novel_but_a_covered_lens_noise_and_another_room_are(recorded):
    session, report = recorded
    assert report.novelty_median < 0.9
    assert report.novel_norm < 0.1
    rng = np.random.default_rng(1)
    strange = {
        "covered": np.full((96, 128), 4, np.uint8),
        "blinded": np.full((96, 128), 255, np.uint8),
        "noise": rng.integers(0, 256, (96, 128)).astype(np.uint8),
    }
    novelty = {
        name: session.learner.predict(session.learner.observe(image)).novelty
        for name, image in strange.items()
    }
    assert min(novelty.values()) > 1.0, novelty
    room = open_recordings([Path(__file__).parents[2] / "data" / "room1"])[0]
    seen = [session.learner.predict(session.learner.observe(pair.left)).novelty for pair in room]
    assert np.median(seen) > 1.1 * report.novelty_median
