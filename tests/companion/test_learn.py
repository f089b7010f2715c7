"""Learning offline: predict first, then learn; train on some, score on others."""

import math
from collections.abc import Iterator

import msgspec
import numpy as np
import pytest

from companion.camera.recording import open_recordings
from companion.kernel.calibration import Intrinsics, StereoCalibration
from companion.kernel.messages import StereoFrame
from companion.learn import run_prequential, run_train_test
from companion.learning.learner import Learner
from companion.learning.learner_settings import LearnerSettings
from companion.learning_report import auc_of_error, coverage_of
from companion.modelfile import save_model
from companion.vision.stereo import StereoSettings
from companion.vision.textons import TextonSettings

EYE = Intrinsics(120.0, 120.0, 64.0, 48.0)
CALIBRATION = StereoCalibration(128, 96, EYE, EYE, baseline_m=0.06)
TRAINING_IMAGES = 20


class SmallPlan(msgspec.Struct, frozen=True):
    seed: int = 1
    stereo: StereoSettings = StereoSettings()
    learner: LearnerSettings = LearnerSettings(
        textons=TextonSettings(training_images=TRAINING_IMAGES)
    )


class PaintedWall:
    """Flights to and from a wall of painted tiles: the nearer, the larger tiles and λ."""

    calibration = CALIBRATION

    def __init__(self, n_frames: int, seed: int) -> None:
        self.n_frames = n_frames
        self.seed = seed

    def __len__(self) -> int:
        return self.n_frames

    def __iter__(self) -> Iterator[StereoFrame]:
        rng = np.random.default_rng(self.seed)
        for index in range(self.n_frames):
            disparity_px = round(5.5 - 4.5 * math.cos(index / 12.0))
            tile_px = 2 * disparity_px
            shape = 96 // tile_px + 2, 160 // tile_px + 2
            wall = np.kron(rng.integers(40, 216, shape), np.ones((tile_px, tile_px)))
            wall = np.clip(wall + rng.normal(0, 4, wall.shape), 0, 255).astype(np.uint8)
            left, right = wall[:96, :128], wall[:96, disparity_px : disparity_px + 128]
            yield StereoFrame(index * 10**8, left.copy(), right.copy())


def plan_with(**changes):
    learner = msgspec.structs.replace(SmallPlan().learner, **changes)
    return SmallPlan(learner=learner)


@pytest.fixture(scope="module")
def tested():
    return run_train_test([PaintedWall(200, 1)], [PaintedWall(80, 2)], SmallPlan(), 5.0)


def test_what_was_learned_holds_for_a_flight_not_seen(tested):
    assert tested.mse_over_variance < 0.35
    assert tested.auc > 0.95
    assert tested.fpr_at_tpr_0_96 < 0.3


def test_the_report_counts_its_frames(tested):
    assert tested.n_frames == 80
    assert tested.n_test == 80
    assert tested.n_train == 200 - TRAINING_IMAGES
    assert tested.positive_threshold_px == 5.0
    assert tested.threshold_px == 5.0
    assert 0.0 <= tested.fpr < tested.tpr <= 1.0


def test_the_report_tells_how_far_to_trust_the_estimate(tested):
    shares = tested.coverage_0_5, tested.coverage_0_8, tested.coverage_0_95
    assert list(shares) == sorted(shares)
    assert tested.coverage_0_5 > 0.2
    assert tested.auc_of_error > 0.5
    assert 0.0 < tested.novelty_median < 2.0
    assert 0.0 <= tested.novel_norm <= 1.0
    assert tested.map is None


def test_maps_are_scored_cell_by_cell():
    plan = plan_with(preset="best", output="map", smooth_frames=1)
    report = run_train_test([PaintedWall(120, 1)], [PaintedWall(60, 2)], plan, 5.0)
    for figures in (report.map.mse_over_variance, report.map.auc, report.map.n_test):
        assert np.shape(figures) == (6, 8)
    assert np.max(report.map.n_test) <= 60
    assert report.map.mse_over_variance_of_all < 0.7
    assert np.nanmedian(report.map.auc) > 0.8


def test_figures_of_an_estimate_with_a_known_error():
    """Errors of one deviation: 0 % within half of it, all within two."""
    rng = np.random.default_rng(1)
    error_px = np.abs(rng.normal(0.0, 1.0, 2000))
    assert coverage_of(error_px, [1.0] * 2000, 1.96) == pytest.approx(0.95, abs=0.02)
    assert coverage_of(error_px, list(error_px / 2.0), 1.0) == 0.0
    assert auc_of_error(error_px, list(error_px)) == 1.0
    assert auc_of_error(error_px, [1.0] * 2000) == pytest.approx(0.5)


def test_prequential_scores_every_frame_that_could_be_predicted():
    report = run_prequential([PaintedWall(120, 1)], SmallPlan(), 5.0)
    assert report.n_frames == 120
    assert report.n_train == 120 - TRAINING_IMAGES
    # The first frame with features is learned from, but nothing was known to predict it by.
    assert report.n_test == report.n_train - 1
    assert report.auc > 0.9


def test_prequential_never_learns_from_a_frame_before_it_predicts_it():
    """On λ of pure chance a memory of five neighbours must do worse than the mean."""

    class Chance(PaintedWall):
        def __iter__(self) -> Iterator[StereoFrame]:
            rng = np.random.default_rng(self.seed)
            for index in range(self.n_frames):
                wall = rng.integers(0, 256, (96, 160)).astype(np.uint8)
                shift = int(rng.integers(1, 12))
                left, right = wall[:, :128], wall[:, shift : shift + 128]
                yield StereoFrame(index, left.copy(), right.copy())

    report = run_prequential([Chance(120, 3)], plan_with(preset="none", smooth_frames=1), 5.0)
    assert report.mse_over_variance > 1.0
    assert 0.3 < report.auc < 0.7


def test_same_plan_same_report(tested):
    again = run_train_test([PaintedWall(200, 1)], [PaintedWall(80, 2)], SmallPlan(), 5.0)
    assert again == tested


def test_threshold_from_the_roc_reaches_its_rate_on_what_it_was_chosen_on():
    report = run_prequential([PaintedWall(200, 1)], plan_with(threshold="roc"), 5.0)
    assert report.tpr >= 0.96
    assert report.fpr == pytest.approx(report.fpr_at_tpr_0_96)


def test_without_positives_rates_are_unknown_and_the_threshold_is_the_fixed_one():
    report = run_prequential([PaintedWall(60, 1)], plan_with(threshold="roc"), 50.0)
    assert math.isnan(report.tpr)
    assert math.isnan(report.auc)
    assert math.isnan(report.fpr_at_tpr_0_96)
    assert report.fpr == 0.0
    assert report.threshold_px == 50.0


def test_a_loaded_dictionary_leaves_all_frames_for_learning(tmp_path):
    learner = Learner(SmallPlan().learner, np.random.default_rng(0))
    for frame in PaintedWall(TRAINING_IMAGES, 1):
        learner.observe(frame.left)
    save_model(tmp_path / "model.npz", learner.state(), CALIBRATION)
    plan = plan_with(dictionary="model.npz")
    assert run_prequential([PaintedWall(30, 2)], plan, 5.0, tmp_path).n_train == 30


class DefaultPlan(msgspec.Struct, frozen=True):
    seed: int = 1
    stereo: StereoSettings = StereoSettings()
    learner: LearnerSettings = LearnerSettings()


def test_on_recorded_flights_it_beats_chance_and_the_mean_by_far(stereoboard):
    takes = sorted(stereoboard.glob("board*"))[:14]
    train, test = open_recordings(takes[::2]), open_recordings(takes[1::2])
    report = run_train_test(train, test, DefaultPlan(), 4.0)
    assert report.n_test > 900
    assert report.mse_over_variance < 0.7
    assert report.auc > 0.85
    assert report.fpr_at_tpr_0_96 < 0.5
