"""Saved models: taken up, or refused in one line."""

import io

import numpy as np
import pytest

from companion.learning.learner import Learner
from companion.learning.learner_settings import LearnerSettings
from companion.modelfile import load_dictionary, load_model, save_model


@pytest.fixture(scope="module")
def model(tmp_path_factory, camera):
    """A saved model of a learner that has seen a little."""
    rng = np.random.default_rng(1)
    learner = Learner(LearnerSettings(), rng)
    for _ in range(60):
        features = learner.observe(rng.integers(0, 256, (96, 128), dtype=np.uint8))
        if features is not None:
            learner.learn(features, 2.0)
    path = tmp_path_factory.mktemp("model") / "model.npz"
    save_model(path, learner.state(), camera)
    return path.read_bytes()


def take_up(path, camera):
    load_dictionary(path)
    learner = Learner(LearnerSettings(), np.random.default_rng(1)).restore(
        load_model(path, camera).state
    )
    learner.predict(learner.observe(np.zeros((96, 128), np.uint8)))


def test_models(fuzz, tmp_path, camera, model):
    path = tmp_path / "model.npz"

    def run(data):
        path.write_bytes(data)
        take_up(path, camera)

    fuzz(run, [model])


def test_models_of_sound_files(fuzz, tmp_path, camera, model):
    """A file as we write it; one of its arrays is not what was learned."""
    path = tmp_path / "model.npz"
    path.write_bytes(model)
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files if name != "header.json"}
    names = sorted(arrays)
    state = load_model(path, camera).state

    def run(data):
        name = names[data[0] % len(names)] if data else names[0]
        try:
            spoilt = np.load(io.BytesIO(data[1:]), allow_pickle=False)
        except Exception:  # noqa: BLE001 - numpy's own reader is not what is tested here
            return
        save_model(path, state._replace(arrays={**state.arrays, name: spoilt}), camera)
        take_up(path, camera)

    fuzz(run, [bytes((number,)) + npy(arrays[name]) for number, name in enumerate(names)])


def npy(array):
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()
