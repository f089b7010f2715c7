"""Learning at the sizes of a long flight, beside the libraries that a user would take instead.

Samples are views of a painted wall from many places: neighbours pay for real images, which fill a
small part of the space of all histograms, and not for random numbers.
"""

from collections.abc import Iterator
from itertools import count, cycle

import cv2
import numpy as np
from minisom import MiniSom
from numpy.typing import NDArray
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF
from sklearn.neighbors import KNeighborsRegressor
from sklearn.neural_network import MLPRegressor

from companion.kernel.calibration import Intrinsics, StereoCalibration
from companion.kernel.messages import Telemetry
from companion.learning.learner import Learner
from companion.learning.learner_settings import LearnerSettings
from companion.regressors import GPRegressor, KNNRegressor, Predictor
from companion.vision.features import Features, Grey
from companion.vision.parallax import Parallax
from companion.vision.textons import TextonEncoder, TextonSettings, TextonTrainer
from sitl.arena.paint import Sheet
from sitl.arena.patterns import plywood_tape
from tools.bench.harness import Row, race_row

WIDTH_PX, HEIGHT_PX = 128, 96
SEED = 1
FEW, MANY = 8_000, 100_000
QUERIES = 64
"""Taken in turn: no query may profit from the one before."""
PATCHES, TRAINING_IMAGES = 50_000, 250
WINDOW = 400
FRAMES = 400


class Wall:
    """A wall painted with tape, 6 x 3 m, seen from straight ahead."""

    def __init__(self, rng: np.random.Generator) -> None:
        sheet = Sheet(600, 1200, 0.005)
        self._grey = (255.0 * np.clip(plywood_tape(sheet, rng), 0.0, 1.0)).astype(np.uint8)
        self._rng = rng

    def view(self) -> tuple[Grey, float]:
        """An image and how many times nearer than its least distance, 1 to 4, it was taken from."""
        zoom = 4.0 ** self._rng.random()
        width, height = round(400 / zoom), round(300 / zoom)
        top = self._rng.integers(self._grey.shape[0] - height + 1)
        left = self._rng.integers(self._grey.shape[1] - width + 1)
        part = self._grey[top : top + height, left : left + width]
        image = cv2.resize(part, (WIDTH_PX, HEIGHT_PX), interpolation=cv2.INTER_AREA)
        return np.asarray(image, dtype=np.uint8), zoom


def rows() -> Iterator[Row]:
    rng = np.random.default_rng(SEED)
    wall = Wall(rng)
    yield _dictionary_row(wall)
    samples, zooms = _samples(wall, rng)
    yield from _neighbour_rows(samples, zooms)
    yield _process_row(samples, zooms)
    yield from _best_rows(wall)
    yield _parallax_row(wall)


def _samples(
    wall: Wall, rng: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Features and zooms of MANY views and the QUERIES."""
    settings = TextonSettings()
    trainer = TextonTrainer(settings, rng)
    while not trainer.finished:
        trainer.update(wall.view()[0])
    encoder = TextonEncoder(trainer.dictionary, settings, rng, LearnerSettings().entropy_scale)
    views = (wall.view() for _ in range(MANY + QUERIES))
    pairs = [(encoder.encode(image), zoom) for image, zoom in views]
    return np.stack([features for features, _ in pairs]), np.array([zoom for _, zoom in pairs])


def _dictionary_row(wall: Wall) -> Row:
    """Theirs learns from patches cut beforehand; ours cuts them itself."""
    settings = TextonSettings(
        training_images=TRAINING_IMAGES, training_patches=PATCHES // TRAINING_IMAGES
    )
    images = [wall.view()[0] for _ in range(TRAINING_IMAGES)]
    patches = np.concatenate([_patches(image, settings.training_patches) for image in images])

    def ours() -> None:
        trainer = TextonTrainer(settings, np.random.default_rng(SEED))
        for image in images:
            trainer.update(image)

    def theirs() -> None:
        for n_textons in (settings.intensity, settings.gradient):
            MiniSom(n_textons, 1, patches.shape[1], random_seed=SEED).train(patches, PATCHES)

    return race_row(
        f"dictionary: two maps from {PATCHES:,} patches",
        ours,
        ("MiniSom", theirs),
        unit="ms",
        goal=1000.0,
        rounds=1,
        warm_up=0,
    )


def _patches(image: Grey, n_patches: int) -> NDArray[np.float32]:
    """Flat patches, evenly over the image: (n_patches, 25)."""
    windows = np.lib.stride_tricks.sliding_window_view(image, (5, 5)).reshape(-1, 25)
    return windows[:: len(windows) // n_patches][:n_patches].astype(np.float32)


def _neighbour_rows(samples: NDArray[np.float32], zooms: NDArray[np.float64]) -> Iterator[Row]:
    queries = samples[MANY:]
    for n_samples, goal_us in ((FEW, 40.0), (MANY, 300.0)):
        known = samples[:n_samples], zooms[:n_samples]
        yield race_row(
            f"kNN: exact query among {n_samples:,} views, in a loop",
            Turns(KNNRegressor(5).fit(*known), queries),
            ("sklearn KNeighborsRegressor", Turns(KNeighborsRegressor(5).fit(*known), queries)),
            unit="us",
            goal=goal_us,
            rounds=5,
            in_a_row=QUERIES,
        )


def _process_row(samples: NDArray[np.float32], zooms: NDArray[np.float64]) -> Row:
    known, targets = samples[:WINDOW], zooms[:WINDOW]
    scaled = ((known - known.mean(axis=0)) / known.std(axis=0).clip(1e-6)).astype(np.float64)
    theirs = GaussianProcessRegressor(RBF(4.0), alpha=0.09, optimizer=None).fit(scaled, targets)
    return race_row(
        f"Gaussian process: predict with {WINDOW} samples",
        Turns(GPRegressor(WINDOW).fit(known, targets), samples[MANY:]),
        ("sklearn GaussianProcessRegressor", Turns(theirs, scaled[:QUERIES])),
        goal=1.0,
    )


def _best_rows(wall: Wall) -> Iterator[Row]:
    """The preset best, on a frame with its views and after a minute's learning."""
    learner = Learner(LearnerSettings(preset="best"), np.random.default_rng(SEED))

    def seen(image: Grey) -> Features:
        features = learner.observe(image)
        assert features is not None, "the preset has no dictionary to learn first"
        return features

    frames = [wall.view() for _ in range(FRAMES)]
    known = np.stack([seen(image) for image, _ in frames])
    zooms = np.array([zoom for _, zoom in frames])

    def learn() -> None:
        image, zoom = next(turn)
        learner.learn(seen(image), zoom, lambda: np.full(image.shape, zoom, np.float32))

    turn = cycle(frames)
    for _ in frames:
        learn()
    theirs = MLPRegressor(hidden_layer_sizes=(64, 32), random_state=SEED).partial_fit(known, zooms)
    yield race_row(
        "best: image to features and estimate",
        lambda: learner.predict(seen(next(turn)[0])),
        ("sklearn MLPRegressor, features given", lambda: theirs.predict(known[:1])),
        goal=2.0,
    )
    yield race_row(
        "best: learn from a frame and its views",
        learn,
        (
            "sklearn MLPRegressor, one batch of 32",
            lambda: theirs.partial_fit(known[:32], zooms[:32]),
        ),
        goal=2.0,
    )


def _parallax_row(wall: Wall) -> Row:
    """Flying towards a wall at 0.5 m/s and 10 Hz, again and again."""
    eye = Intrinsics(117.0, 117.0, WIDTH_PX / 2, HEIGHT_PX / 2)
    parallax = Parallax(StereoCalibration(WIDTH_PX, HEIGHT_PX, eye, eye, 0.06), "left")
    level = Telemetry(velocity_ned_m_s=(0.5, 0.0, 0.0), roll_rad=0.0, pitch_rad=0.0, yaw_rad=0.0)
    from_afar = wall.view()[0]
    centre = (WIDTH_PX / 2, HEIGHT_PX / 2)
    zooms = 3.0 / (3.0 - 0.05 * np.arange(20))
    views = [cv2.getRotationMatrix2D(centre, 0.0, zoom) for zoom in zooms]
    images: list[Grey] = [
        np.asarray(cv2.warpAffine(from_afar, view, (WIDTH_PX, HEIGHT_PX)), dtype=np.uint8)
        for view in views
    ]
    turn, numbers, pairs = cycle(images), count(), cycle(zip(images, images[6:], strict=False))
    return race_row(
        "best: image and motion to nearness",
        lambda: parallax.observe(next(turn), next(numbers) * 10**8, level),
        ("OpenCV dense flow (Farneback)", lambda: _dense_flow(*next(pairs))),
        goal=1.0,
    )


def _dense_flow(before: Grey, after: Grey) -> object:
    flow = np.zeros((*before.shape, 2), np.float32)
    return cv2.calcOpticalFlowFarneback(before, after, flow, 0.5, 3, 15, 3, 5, 1.2, 0)


class Turns:
    """Predicts for one query after the other."""

    def __init__(self, model: Predictor, queries: NDArray[np.float32]) -> None:
        self._predict = model.predict
        self._queries = queries
        self._place = 0

    def __call__(self) -> object:
        self._place = (self._place + 1) % len(self._queries)
        return self._predict(self._queries[self._place : self._place + 1])
