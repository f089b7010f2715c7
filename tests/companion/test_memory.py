"""What was learned outlives the flight, whatever becomes of the newest file."""

import itertools
import threading
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion import modelfile
from companion.kernel.calibration import Intrinsics, StereoCalibration
from companion.kernel.errors import CompanionError, PlanError
from companion.kernel.settings import convert_settings
from companion.learning.learner import Learner, LearnerState
from companion.learning.learner_settings import LearnerSettings
from companion.memory import MODEL_NAME, ModelKeeper, previous_of, recall
from companion.modelfile import UnreadableModelError, load_model, save_model
from companion.regressors import REGRESSORS

EYE = Intrinsics(120.0, 120.0, 64.0, 48.0)
CALIBRATION = StereoCalibration(128, 96, EYE, EYE, baseline_m=0.06)
SECOND_NS = 1_000_000_000


def settings(**table):
    return convert_settings({"preset": "none", **table}, LearnerSettings, "plan.toml: learner")


def taught(n_samples=20, **table):
    """Gradients need no dictionary, so that two samples make a learner."""
    learner = Learner(settings(features="gradients", **table), np.random.default_rng(0))
    return teach(learner, n_samples)


def teach(learner, n_samples):
    rng = np.random.default_rng(1)
    for number in range(n_samples):
        image = rng.integers(0, 256, (96, 128)).astype(np.uint8)
        learner.learn(learner.observe(image), 2.0 + number % 7)
    return learner


def learner_like(learner):
    return Learner(learner.settings, np.random.default_rng(3))


def answer(learner):
    learner.break_sequence()
    image = np.random.default_rng(5).integers(0, 256, (96, 128)).astype(np.uint8)
    return learner.predict(learner.observe(image))


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A whole model: its learner and the file's bytes."""
    path = tmp_path_factory.mktemp("model") / MODEL_NAME
    learner = taught(4)
    save_model(path, learner.state(), CALIBRATION, flown_s=61.5)
    return learner, path.read_bytes()


def write(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


# -- the file ----------------------------------------------------------------------------------


@given(st.data())
def test_no_damage_passes_for_a_model(tmp_path_factory, saved, data):
    content = bytearray(saved[1])
    place = data.draw(st.integers(0, len(content) - 1))
    if data.draw(st.booleans()):
        content[place] ^= data.draw(st.integers(1, 255))
    else:
        del content[place:]
    path = tmp_path_factory.mktemp("damaged") / MODEL_NAME
    path.write_bytes(content)
    with pytest.raises(UnreadableModelError, match=r"model\.npz: not a saved model") as caught:
        load_model(path, CALIBRATION)
    assert "\n" not in str(caught.value)


SPOILS = (
    lambda values: values[..., :-1],
    lambda values: np.full_like(values, np.nan),
    lambda values: values.T[:1],
)


def spoilt_states(state):
    """Every array missing, or spoilt in one of the ways."""
    spoils = itertools.cycle(SPOILS)
    for name, values in state.arrays.items():
        yield {key: kept for key, kept in state.arrays.items() if key != name}
        if values.ndim and values.dtype.kind == "f":
            yield {**state.arrays, name: next(spoils)(values)}


@pytest.mark.parametrize("regressor", sorted(set(REGRESSORS) - {"cnn"}))  # which needs pixels
def test_arrays_that_do_not_fit_are_refused_before_the_flight(regressor):
    """Or are harmless: it still gives an answer, and learns on."""
    learner = taught(10, regressor=regressor)
    n_refused, states = 0, list(spoilt_states(learner.state()))[:25]
    for arrays in states:
        again = learner_like(learner)
        try:
            again.restore(LearnerState(arrays, learner.state().meaning))
        except PlanError as error:
            n_refused += str(error).startswith("saved model does not fit together")
        else:
            assert np.isfinite(answer(teach(again, 1)).mono_px)
    assert n_refused >= len(states) / 2


def test_a_model_of_another_version_is_refused_as_such(tmp_path, monkeypatch):
    monkeypatch.setattr(modelfile, "VERSION", 99)
    save_model(tmp_path / MODEL_NAME, taught(2).state(), CALIBRATION)
    monkeypatch.undo()
    with pytest.raises(PlanError, match=r"model of version 99; this program reads \d+$") as caught:
        load_model(tmp_path / MODEL_NAME, CALIBRATION)
    assert not isinstance(caught.value, UnreadableModelError)  # an older one would be no better


# -- finding one -------------------------------------------------------------------------------


def test_a_file_a_flight_and_a_folder_of_flights_lead_to_the_same_model(tmp_path, saved):
    learner, content = saved
    path = write(tmp_path / "20260102T000000Z-room1-1" / MODEL_NAME, content)
    write(tmp_path / "20260101T000000Z-room1-1" / MODEL_NAME, b"older")
    (tmp_path / "20260103T000000Z-room1-1").mkdir()
    for where in (path, path.parent, tmp_path):
        found = recall(where, CALIBRATION)
        assert (found.path, found.saved.flown_s) == (path, 61.5)
        again = learner_like(learner)
        found.teach(again)
        assert answer(again) == answer(learner)


@pytest.mark.parametrize("newest", [b"", b"half of it", None])
def test_a_spoilt_newest_falls_back_to_the_one_before_and_says_so(tmp_path, saved, newest, caplog):
    path = tmp_path / MODEL_NAME
    write(previous_of(path), saved[1])
    if newest is not None:
        write(path, newest)
    for where in (path, tmp_path):
        caplog.clear()
        assert recall(where, CALIBRATION).path == previous_of(path)
        assert f"taking the one saved before it, {previous_of(path)}" in caplog.text


def test_where_nothing_is_left_it_says_what_was_looked_for(tmp_path):
    with pytest.raises(PlanError, match=r"no model\.npz in it, nor in a flight's folder in it"):
        recall(tmp_path, CALIBRATION)
    with pytest.raises(PlanError, match=r"none\.npz: no such file"):
        recall(tmp_path / "none.npz", CALIBRATION)


def test_a_model_that_does_not_fit_is_no_reason_to_take_an_older_one(tmp_path, saved):
    path = write(tmp_path / MODEL_NAME, saved[1])
    write(previous_of(path), saved[1])
    wide = StereoCalibration(640, 480, EYE, EYE, baseline_m=0.06)
    with pytest.raises(PlanError, match="model of a 128 x 96 camera; this one is 640 x 480"):
        recall(path, wide)
    other = Learner(settings(features="gradients", regressor="mlp"), np.random.default_rng(0))
    with pytest.raises(PlanError, match=rf"^{path}: saved model was learned with learner.regres"):
        recall(path, CALIBRATION).teach(other)


# -- saving in flight --------------------------------------------------------------------------


@pytest.fixture
def keeper(tmp_path):
    return ModelKeeper(tmp_path / MODEL_NAME, CALIBRATION, period_s=30.0, patient=True)


def n_samples_in(path):
    return len(load_model(path, CALIBRATION).state.arrays["estimator.regressor.y"])


def test_it_saves_every_30_seconds_of_flight_and_keeps_the_one_before(tmp_path, keeper):
    learner, saved_at = taught(1), []
    for second in range(100):
        teach(learner, 1)
        keeper.offer(second * SECOND_NS, learner, flown_s=second)
        keeper._busy(5.0)
        path = tmp_path / MODEL_NAME
        if path.exists():
            saved_at.append(load_model(path, CALIBRATION).flown_s)
    assert sorted(set(saved_at)) == [30.0, 60.0, 90.0]
    keeper.finish(learner, flown_s=100.0)
    newest, previous = tmp_path / MODEL_NAME, previous_of(tmp_path / MODEL_NAME)
    assert [load_model(path, CALIBRATION).flown_s for path in (previous, newest)] == [90.0, 100.0]
    assert (n_samples_in(previous), n_samples_in(newest)) == (92, 101)
    assert sorted(tmp_path.iterdir()) == [newest, previous]


def test_what_is_saved_is_what_was_known_then(tmp_path, keeper):
    learner = taught(5)
    keeper.offer(0, learner, 0.0)
    keeper.offer(30 * SECOND_NS, learner, 30.0)
    teach(learner, 500)  # while the thread may still be writing
    keeper._busy(5.0)
    assert n_samples_in(tmp_path / MODEL_NAME) == 5


def test_a_disk_that_is_slow_costs_saves_but_no_time(tmp_path, monkeypatch, caplog):
    answers, asked = threading.Event(), threading.Event()

    def slow_save(*arguments):
        asked.set()
        answers.wait(10.0)
        save_model(*arguments)

    monkeypatch.setattr("companion.memory.save_model", slow_save)
    keeper = ModelKeeper(tmp_path / MODEL_NAME, CALIBRATION, period_s=30.0, patient=False)
    learner = taught(3)
    for second in (0, 30, 60, 90):
        keeper.offer(second * SECOND_NS, learner, second)
    assert asked.wait(10.0)
    assert caplog.text.count("the last save is still under way; leaving one out") == 2
    answers.set()
    keeper.finish(learner, 95.0)
    assert load_model(tmp_path / MODEL_NAME, CALIBRATION).flown_s == 95.0


def test_a_disk_that_never_answers_does_not_keep_it_from_ending(tmp_path, monkeypatch):
    answers = threading.Event()
    monkeypatch.setattr("companion.memory.save_model", lambda *_: answers.wait(10.0))
    monkeypatch.setattr("companion.memory.DISK_LIMIT_S", 0.05)
    keeper = ModelKeeper(tmp_path / MODEL_NAME, CALIBRATION, period_s=30.0, patient=False)
    for second in (0, 30):
        keeper.offer(second * SECOND_NS, taught(3), second)
    with pytest.raises(CompanionError, match=r"model\.npz: model cannot be written: a save has"):
        keeper.finish(taught(3), 31.0)
    answers.set()


def test_a_full_disk_is_said_and_flown_past_but_not_landed_past(tmp_path, caplog):
    keeper = ModelKeeper(tmp_path / "gone" / MODEL_NAME, CALIBRATION, 30.0, patient=True)
    learner = taught(3)
    for second in (0, 30):
        keeper.offer(second * SECOND_NS, learner, second)
    keeper._busy(5.0)
    assert "model cannot be written: No such file or directory" in caplog.text
    with pytest.raises(CompanionError, match="model cannot be written"):
        keeper.finish(learner, 31.0)


def test_with_a_period_of_zero_only_landing_saves(tmp_path):
    keeper = ModelKeeper(tmp_path / MODEL_NAME, CALIBRATION, period_s=0.0, patient=True)
    learner = taught(3)
    offer = partial(keeper.offer, learner=learner, flown_s=1.0)
    for second in range(100):
        offer(second * SECOND_NS)
    assert not list(tmp_path.iterdir())
    keeper.finish(learner, 100.0)
    assert [path.name for path in tmp_path.iterdir()] == [MODEL_NAME]
