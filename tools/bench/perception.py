"""Perception of one frame at the paper's size, beside the same method from common libraries."""

import math
from collections import deque
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from sklearn.neighbors import KNeighborsRegressor

from companion.health import CameraHealth, HealthSettings
from companion.kernel.calibration import Intrinsics, StereoCalibration
from companion.kernel.messages import StereoFrame
from companion.learning.learner import Learner
from companion.learning.learner_settings import LearnerSettings
from companion.vision.stereo import StereoMatcher, StereoSettings
from companion.vision.textons import TextonSettings
from tools.bench.harness import Row, race_row

WIDTH_PX, HEIGHT_PX = 128, 96
PLANTED_PX = 6
SAMPLES = 8000
SEED = 1

Grey = NDArray[np.uint8]


class Parts:
    """Everything trained, once: our parts, and a frame to feed them."""

    def __init__(self) -> None:
        rng = np.random.default_rng(SEED)
        self.left, self.right = stereo_pair(rng)
        eye = Intrinsics(117.0, 117.0, WIDTH_PX / 2, HEIGHT_PX / 2)
        calibration = StereoCalibration(WIDTH_PX, HEIGHT_PX, eye, eye, 0.06)
        self.matcher = StereoMatcher(StereoSettings(), calibration)
        self.learner = Learner(LearnerSettings(), rng)
        self.matcher.match(self.left, self.right)
        self.health = CameraHealth(HealthSettings())
        others = stereo_pair(rng)
        self.frames = deque(
            [StereoFrame(1, self.left, self.right), StereoFrame(2, others[0], others[1])]
        )
        while not self.learner.ready:
            self.learner.observe(stereo_pair(rng)[0])
        self.samples = rng.random((SAMPLES, self.textons.n_features), dtype=np.float32)
        self.targets = rng.random(SAMPLES)
        for features, target in zip(self.samples, self.targets, strict=True):
            self.learner.learn(features, float(target))

    @property
    def textons(self) -> TextonSettings:
        return self.learner.settings.textons

    @property
    def neighbours(self) -> int:
        return self.learner.settings.k

    def perceive(self) -> float:
        stereo = self.matcher.match(self.left, self.right)
        mono = self.learner.predict(self.learner.observe(self.left))
        return stereo.disparity_px + mono.mono_px

    def look(self) -> bool:
        """As in flight, but for the match itself; two pairs in turn, so that nothing is frozen."""
        self.frames.rotate()
        frame = self.frames[0]
        self.health.look(frame)
        return self.health.compare(self.matcher.last_matches(), 0.8)


class Libraries:
    """The same steps as a user would write them with numpy, OpenCV and scikit-learn."""

    def __init__(self, parts: Parts) -> None:
        self._parts = parts
        stereo = parts.matcher.settings
        self._bm = cv2.StereoBM.create(stereo.disparities_px, stereo.block_px)
        dictionary = parts.learner.dictionary
        assert dictionary is not None
        self._dictionary = dictionary
        self._places = self._grid(parts.textons)
        self._knn = KNeighborsRegressor(parts.neighbours).fit(parts.samples, parts.targets)

    def _grid(self, settings: TextonSettings) -> tuple[NDArray[Any], NDArray[Any]]:
        side = math.isqrt(settings.patches)
        rows = np.linspace(0, HEIGHT_PX - settings.patch_px, side).round().astype(int)
        columns = np.linspace(0, WIDTH_PX - settings.patch_px, side).round().astype(int)
        return rows.repeat(side), np.tile(columns, side)

    def match(self) -> float:
        disparity = self._bm.compute(self._parts.left, self._parts.right)
        return float(disparity[disparity >= 0].mean() / 16.0)

    def bag_of_words(self) -> NDArray[np.float64]:
        size = self._parts.textons.patch_px
        windows = np.lib.stride_tricks.sliding_window_view(self._parts.left, (size, size))
        patches = windows[self._places].astype(np.float32) - np.float32(128)
        gradients = np.gradient(patches, axis=2).reshape(len(patches), -1)
        words = [
            self._histogram(patches.reshape(len(patches), -1), self._dictionary.intensity),
            self._histogram(gradients, self._dictionary.gradient),
        ]
        histogram = np.concatenate(words)
        known = histogram[histogram > 0]
        return np.append(histogram, -(known * np.log2(known)).sum())

    @staticmethod
    def _histogram(patches: NDArray[Any], textons: NDArray[Any]) -> NDArray[np.float64]:
        distance = ((patches[:, None] - textons[None]) ** 2).sum(axis=2)
        counts = np.bincount(distance.argmin(axis=1), minlength=len(textons))
        return counts / (2.0 * len(patches))

    def predict(self) -> float:
        return float(self._knn.predict(self._parts.samples[:1])[0])

    def look(self) -> float:
        parts = self._parts
        parts.frames.rotate()
        now, before = parts.frames
        figures = 0.0
        for image, last in ((now.left, before.left), (now.right, before.right)):
            figures += cv2.Laplacian(image, cv2.CV_16S).std()
            figures += cv2.calcHist([image], [0], None, [16], [0, 256]).ravel()[0]
            figures += cv2.absdiff(image, last).mean()
        return float(figures)

    def perceive(self) -> float:
        features = self.bag_of_words()[None]
        return self.match() + float(self._knn.predict(features.astype(np.float32))[0])


def rows() -> Iterator[Row]:
    parts = Parts()
    theirs = Libraries(parts)
    learner, sample = parts.learner, parts.samples[0]
    yield race_row(
        "perceive a frame, 8,000 samples",
        parts.perceive,
        ("numpy + cv2.StereoBM + sklearn", theirs.perceive),
        goal=0.8,
    )
    yield race_row(
        "stereo: pair to λ",
        lambda: parts.matcher.match(parts.left, parts.right),
        ("cv2.StereoBM and a mean", theirs.match),
    )
    yield race_row(
        "camera health: look at a pair, compare its matches",
        parts.look,
        ("cv2: sharpness, light and change of both eyes", theirs.look),
        goal=0.3,
    )
    yield race_row(
        "textons: image to features",
        lambda: learner.observe(parts.left),
        ("numpy bag of words", theirs.bag_of_words),
        goal=0.1,
    )
    yield race_row(
        "kNN: predict among 8,000 samples",
        lambda: learner.predict(sample),
        ("sklearn KNeighborsRegressor", theirs.predict),
    )
    yield race_row(
        "kNN: learn one more sample",
        lambda: learner.learn(sample, 1.0),
        (
            "sklearn fit, 8,000 samples",
            lambda: KNeighborsRegressor(parts.neighbours).fit(parts.samples, parts.targets),
        ),
        unit="us",
        rounds=100,
    )


def stereo_pair(rng: np.random.Generator) -> tuple[Grey, Grey]:
    """A textured plane, PLANTED_PX of disparity: uint8, (height, width) each."""
    noise = cv2.GaussianBlur(rng.normal(size=(HEIGHT_PX, WIDTH_PX + PLANTED_PX)), (0, 0), 1.5)
    wall = np.interp(noise, (noise.min(), noise.max()), (0, 255)).astype(np.uint8)
    return np.ascontiguousarray(wall[:, :WIDTH_PX]), np.ascontiguousarray(wall[:, PLANTED_PX:])
