"""The learner finds a planted relation between texture and λ, keeps it, and saves it."""

import math

import numpy as np
import pytest

from companion.kernel.calibration import Intrinsics, StereoCalibration
from companion.kernel.errors import CompanionError, PlanError
from companion.kernel.messages import StereoFrame
from companion.kernel.settings import convert_settings
from companion.learning.learner import Learner, dictionary_of
from companion.learning.learner_settings import LearnerSettings
from companion.modelfile import load_dictionary, load_model, save_model

EYE = Intrinsics(120.0, 120.0, 64.0, 48.0)
CALIBRATION = StereoCalibration(128, 96, EYE, EYE, baseline_m=0.06)
QUICK = {"textons": {"training_images": 20}}


def settings(**table):
    return convert_settings({**QUICK, **table}, LearnerSettings, "plan.toml: learner")


def view(disparity_px, rng):
    """A wall of painted tiles, the larger the nearer: (96, 128)."""
    tile_px = max(2, round(2.0 * disparity_px))
    shape = 96 // tile_px + 2, 128 // tile_px + 2
    tiles = np.kron(rng.integers(40, 216, shape), np.ones((tile_px, tile_px)))
    top, left = rng.integers(0, tile_px, 2)
    return tiles[top : top + 96, left : left + 128].astype(np.uint8)


def taught(learner, n_frames=300, seed=1):
    rng = np.random.default_rng(seed)
    for _ in range(n_frames):
        disparity_px = rng.uniform(1.0, 12.0)
        learner.learn(learner.observe(view(disparity_px, rng)), disparity_px)
    return learner


@pytest.fixture(scope="module")
def learned():
    """Shared by tests that do not change it further."""
    return taught(Learner(settings(smooth_frames=1, preset="none"), np.random.default_rng(0)))


def estimates(learner, disparities_px, seed=9):
    rng = np.random.default_rng(seed)
    learner.break_sequence()
    views = [view(disparity_px, rng) for disparity_px in disparities_px]
    return np.array([learner.predict(learner.observe(image))[:2] for image in views])


def test_it_learns_a_planted_relation(learned):
    truth_px = np.random.default_rng(8).uniform(1.0, 12.0, 60)
    mono_px, std_px = estimates(learned, truth_px).T
    assert np.mean((mono_px - truth_px) ** 2) < 0.15 * truth_px.var()
    assert (std_px > 0.0).all()
    assert std_px.mean() < truth_px.std()


def test_images_are_no_features_until_the_dictionary_is_learned():
    learner = Learner(settings(), np.random.default_rng(0))
    rng = np.random.default_rng(1)
    ready = [learner.observe(view(4.0, rng)) is not None for _ in range(25)]
    assert ready == [False] * 20 + [True] * 5
    assert learner.ready


def test_a_given_dictionary_is_used_at_once(learned):
    learner = Learner(settings(), np.random.default_rng(0), learned.dictionary)
    assert learner.observe(view(4.0, np.random.default_rng(1))) is not None


def test_a_dictionary_of_another_size_is_refused(learned):
    other = settings(preset="none", textons={"intensity": 8})
    with pytest.raises(PlanError, match=r"shape \(10, 25\) .* ask for \(8, 25\)"):
        Learner(other, np.random.default_rng(0), learned.dictionary)


def test_before_the_first_sample_the_estimate_is_unknown(learned):
    learner = Learner(settings(), np.random.default_rng(0), learned.dictionary)
    features = learner.observe(view(4.0, np.random.default_rng(1)))
    for unknown in (learner.predict(features), learner.predict(None)):
        assert all(math.isnan(value) for value in unknown[:3])
        assert unknown.map_px is None


def test_unknown_targets_and_missing_features_teach_nothing(learned):
    learner = Learner(settings(), np.random.default_rng(0), learned.dictionary)
    features = learner.observe(view(4.0, np.random.default_rng(1)))
    assert not learner.learn(features, math.nan)
    assert not learner.learn(None, 4.0)
    assert math.isnan(learner.predict(features).mono_px)
    assert learner.learn(features, 4.0)
    assert learner.predict(features).mono_px == 4.0


def test_the_estimate_is_the_mean_over_the_last_four_frames(learned):
    learner = Learner(settings(), np.random.default_rng(0), learned.dictionary)
    learner.restore(learned.state())
    raw_px = estimates(learned, np.linspace(2, 10, 8))[:, 0]
    smooth_px = estimates(learner, np.linspace(2, 10, 8))[:, 0]
    expected_px = [raw_px[max(0, i - 3) : i + 1].mean() for i in range(8)]
    np.testing.assert_allclose(smooth_px, expected_px)


def test_a_break_in_the_sequence_is_not_smoothed_over(learned):
    learner = Learner(settings(), np.random.default_rng(0), learned.dictionary)
    learner.restore(learned.state())
    first_px = estimates(learner, [3.0] * 4)[:, 0]
    again_px = estimates(learner, [3.0] * 4)[:, 0]
    np.testing.assert_array_equal(first_px, again_px)


def test_frozen_it_predicts_but_learns_no_more():
    learner = taught(Learner(settings(), np.random.default_rng(0)), 60)
    learner.freeze()
    before = learner.state().arrays
    taught(learner, 30, seed=5)
    for name, values in learner.state().arrays.items():
        np.testing.assert_array_equal(values, before[name])


def test_same_seed_same_learner():
    first, second = (taught(Learner(settings(), np.random.default_rng(4)), 60) for _ in range(2))
    for name, values in first.state().arrays.items():
        np.testing.assert_array_equal(values, second.state().arrays[name])


def test_each_eye_can_be_the_one():
    left, right = np.zeros((2, 96, 128), np.uint8)
    frame = StereoFrame(0, left, right)
    for eye, image in (("left", left), ("right", right)):
        learner = Learner(settings(eye=eye), np.random.default_rng(0))
        assert learner.image_of(frame) is image


@pytest.mark.parametrize(
    ("table", "key"),
    [
        ({"k": 7}, r"k = 7 .* is 5"),
        ({"smooth_frames": 1}, r"smooth_frames = 1 .* is 4"),
        ({"textons": {"patches": 100}}, r"textons\.patches = 100 .* is 500"),
        ({"textons": {"gradient": 0}}, "gradient"),
    ],
)
def test_the_papers_preset_holds_table_one(table, key):
    with pytest.raises(PlanError, match=key):
        convert_settings({"preset": "paper", **table}, LearnerSettings, "plan.toml")


def test_without_preset_table_one_is_free_and_still_the_default():
    free = convert_settings({"preset": "none", "k": 7}, LearnerSettings, "plan.toml")
    assert free.k == 7
    assert (free.smooth_frames, free.textons.patches, free.textons.patch_px) == (4, 500, 5)


def test_fixed_threshold_is_the_plans_or_a_share_of_stereos():
    assert settings(threshold_px=3.0).fixed_threshold_px(4.0) == 3.0
    assert settings(threshold_ratio=0.75).fixed_threshold_px(4.0) == 3.0


def test_a_saved_model_flies_on_as_if_it_had_never_landed(tmp_path, learned):
    save_model(tmp_path / "model.npz", learned.state(), CALIBRATION)
    again = Learner(settings(smooth_frames=1, preset="none"), np.random.default_rng(7))
    again.restore(load_model(tmp_path / "model.npz", CALIBRATION).state)
    truth_px = np.linspace(1, 12, 10)
    np.testing.assert_array_equal(estimates(again, truth_px), estimates(learned, truth_px))
    assert [path.name for path in tmp_path.iterdir()] == ["model.npz"]


def test_saving_again_gives_the_same_bytes_and_replaces_the_old(tmp_path, learned):
    path = tmp_path / "model.npz"
    path.write_text("an older file")
    save_model(path, learned.state(), CALIBRATION)
    first = path.read_bytes()
    save_model(path, learned.state(), CALIBRATION)
    assert path.read_bytes() == first


def test_a_saved_dictionary_can_be_had_alone(tmp_path, learned):
    save_model(tmp_path / "model.npz", learned.state(), CALIBRATION)
    loaded = load_dictionary(tmp_path / "model.npz")
    np.testing.assert_array_equal(loaded.gradient, learned.dictionary.gradient)


def test_a_model_without_textons_says_so(tmp_path):
    fresh = Learner(settings(), np.random.default_rng(0)).state()
    assert dictionary_of(fresh) is None
    save_model(tmp_path / "model.npz", fresh, CALIBRATION)
    with pytest.raises(PlanError, match=r"model\.npz: model has no textons"):
        load_dictionary(tmp_path / "model.npz")


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        (StereoCalibration(64, 48, EYE, EYE, 0.06), "model of a 128 x 96 camera; this one is 64"),
        (StereoCalibration(128, 96, EYE, EYE, 0.12), "7.2 px at 1 m; this one has 14.4 px"),
    ],
)
def test_a_model_of_another_camera_is_refused(tmp_path, learned, camera, message):
    save_model(tmp_path / "model.npz", learned.state(), CALIBRATION)
    with pytest.raises(PlanError, match=message):
        load_model(tmp_path / "model.npz", camera)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"eye": "right"}, r"learner\.eye = 'left'; the plan says 'right'"),
        ({"entropy_scale": 1.0}, r"learner\.entropy_scale = 0\.1"),
        ({"preset": "none", "textons": {"intensity": 8}}, r"textons\.intensity = 10; .* says 8"),
    ],
)
def test_a_model_of_other_settings_is_refused(learned, table, message):
    other = Learner(settings(**table), np.random.default_rng(0))
    with pytest.raises(PlanError, match=message):
        other.restore(learned.state())


@pytest.mark.parametrize("content", [b"", b"words", b"PK\x03\x04 cut short"])
def test_what_is_no_model_is_refused_in_one_line(tmp_path, content):
    path = tmp_path / "model.npz"
    path.write_bytes(content)
    with pytest.raises(PlanError, match=r"model\.npz: not a saved model"):
        load_model(path, CALIBRATION)


def test_a_truncated_model_or_an_array_file_is_refused(tmp_path, learned):
    path = tmp_path / "model.npz"
    save_model(path, learned.state(), CALIBRATION)
    path.write_bytes(path.read_bytes()[:-2000])
    with pytest.raises(PlanError, match="not a saved model"):
        load_model(path, CALIBRATION)
    with path.open("wb") as file:
        np.save(file, np.zeros(3))
    with pytest.raises(PlanError, match="not a saved model"):
        load_model(path, CALIBRATION)


def test_a_missing_model_and_an_unwritable_place_are_named(tmp_path, learned):
    with pytest.raises(PlanError, match=r"gone\.npz: no such file"):
        load_model(tmp_path / "gone.npz", CALIBRATION)
    with pytest.raises(CompanionError, match="model cannot be written"):
        save_model(tmp_path / "nowhere" / "model.npz", learned.state(), CALIBRATION)


def test_the_entropy_alone_is_one_feature_that_falls_as_the_wall_nears(learned):
    learner = Learner(
        settings(preset="none", features="entropy", regressor="ridge", smooth_frames=1),
        np.random.default_rng(0),
        learned.dictionary,
    )
    rng = np.random.default_rng(2)
    entropies = [learner.observe(view(px, rng)) for px in np.linspace(1.0, 12.0, 60)]
    assert {entropy.shape for entropy in entropies} == {(1,)}
    assert np.corrcoef(np.concatenate(entropies), np.arange(60))[0, 1] < -0.8
    taught(learner, 200)
    assert (
        estimates(learner, [11.0] * 10)[:, 0].mean() > estimates(learner, [2.0] * 10)[:, 0].mean()
    )
