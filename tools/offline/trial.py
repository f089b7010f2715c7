"""One run of a study: a learner taught on the training set of a fold, scored as it grows."""

import math
from collections.abc import Iterator, Sequence
from itertools import cycle

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from companion.judging.performance import OnlinePerformance, roc_curve
from companion.kernel.errors import RecordingError
from companion.learning.learner import Learner
from companion.learning_report import WANTED_TPR
from companion.vision.features import Features, Grey
from companion.vision.stereo import StereoMatcher
from tools.offline.features import KeptFeatures
from tools.offline.splits import Fold, in_flight_order, spread, thinned
from tools.offline.store import Stored, digest
from tools.offline.study import Study, StudySettings, Variant

NOT_OF_FEATURES = frozenset(f"learner.{key}" for key in ("regressor", "target", "label", "output"))
"""Of what samples mean, that which features do not depend on."""

Frames = NDArray[np.int64]
"""(n, 2): recording and row."""


class Score(msgspec.Struct, frozen=True):
    """An estimate against stereo's λ on one set; NaN where nothing defines a figure."""

    n: int
    mse: float
    mse_over_variance: float
    auc: float
    fpr: float
    """At TPR 0.96."""


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One learner after one number of samples."""

    learner: str
    dimension: str
    setting: str
    split: str
    fold: int
    seed: int
    size: int
    """Samples asked for; 0: all."""
    n_learned: int
    train: Score
    test: Score


class Trial(msgspec.Struct, frozen=True):
    """All that a run needs, so that any process can do it."""

    variant: Variant
    settings: StudySettings
    fold: Fold
    seed: int
    recordings: tuple[Stored, ...]
    dictionary: Stored | None
    """Whose images textons come from, where they are not the fold's own."""

    @property
    def id(self) -> str:
        """The same for the same question about the same recordings."""
        used = [recording.key for recording in self.recordings]
        asked = self.settings.sizes, self.settings.order, self.settings.scored_frames
        keys = used, self.dictionary.key if self.dictionary else ""
        parts = [(part.recording, part.rows.tobytes().hex()) for part in self.fold.train]
        parts += [(part.recording, part.rows.tobytes().hex()) for part in self.fold.test]
        threshold_px = self.settings.positive_threshold_px
        return digest(self.variant, self.seed, *asked, *keys, parts, threshold_px)

    @property
    def label(self) -> str:
        words = self.variant.learner, self.variant.dimension, self.variant.setting
        return f"{' '.join(filter(None, words))}, {self.fold.split} {self.fold.number}"


def run_trial(trial: Trial) -> list[Row]:
    """A row for each training-set size that the training set has."""
    student = Student(trial)
    settings, fold = trial.settings, trial.fold
    flown = student.known(in_flight_order(fold.train))
    if not len(flown):
        raise RecordingError("stereo knew λ of no frame of the training set")
    student.make_dictionary(flown)
    order = spread(flown) if settings.order == "spread" else flown
    tested = thinned(student.known(in_flight_order(fold.test)), settings.scored_frames)
    rows = []
    learned = 0
    for size in _sizes(settings.sizes, len(order)):
        until = size or len(order)
        student.teach(order[learned:until])
        learned = until
        known = order[:learned]
        seen = thinned(known[np.lexsort(known.T[::-1])], settings.scored_frames)
        rows.append(
            Row(
                learner=trial.variant.learner,
                dimension=trial.variant.dimension,
                setting=trial.variant.setting,
                split=fold.split,
                fold=fold.number,
                seed=trial.seed,
                size=size,
                n_learned=learned,
                train=student.score(seen),
                test=student.score(tested),
            )
        )
    student.keep_features()
    return rows


def _sizes(wanted: Sequence[int], available: int) -> list[int]:
    """Those that can be reached, and 0 (all there are) in place of the ones that cannot."""
    reached = sorted(size for size in wanted if size < available)
    return reached if wanted and max(wanted) < available else [*reached, 0]


class Student:
    """A learner, and the recordings that it sees; sees each frame as it would in flight."""

    def __init__(self, trial: Trial) -> None:
        self._trial = trial
        plan = msgspec.structs.replace(trial.variant.plan, seed=trial.seed)
        self._plan = plan
        self.learner = Learner(plan.learner, np.random.default_rng(plan.seed))
        self._images = [recording.images for recording in trial.recordings]
        column = 0 if plan.learner.label == "mean" else 1
        self._labels_px = [r.labels(plan.stereo)[:, column] for r in trial.recordings]
        self._features: dict[int, KeptFeatures] = {}
        self._matchers: dict[int, StereoMatcher] = {}

    def known(self, frames: Frames) -> Frames:
        """The frames whose λ stereo knew."""
        known = [not math.isnan(self._labels_px[recording][row]) for recording, row in frames]
        return np.asarray(frames[np.array(known, dtype=bool)])

    def make_dictionary(self, flown: Frames) -> None:
        """Learns textons, where the features need any."""
        images = self._dictionary_images(flown)
        while not self.learner.ready:
            self.learner.observe(next(images))

    def _dictionary_images(self, flown: Frames) -> Iterator[Grey]:
        """Again from the start where there are fewer than the dictionary wants."""
        source = self._trial.variant.lab.dictionary
        if self._trial.dictionary is not None:
            eye = 0 if self._plan.learner.eye == "left" else 1
            return (self._sized(images[eye]) for images in cycle(self._trial.dictionary.images))
        chosen = spread(flown) if source == "pooled" else flown
        return (self._image(*frame) for frame in cycle(chosen))

    def teach(self, frames: Frames) -> None:
        for recording, row in frames:
            label_px = float(self._labels_px[recording][row])
            if not (self._plan.learner.design.views or self._plan.learner.output == "map"):
                self.learner.learn(self._features_of(recording, row), label_px)
                continue
            matcher = self._matcher(recording)
            matcher.match(*self._images[recording][row])
            features = self.learner.observe(self._image(recording, row))
            self.learner.learn(features, label_px, matcher.last_map)

    def score(self, frames: Frames) -> Score:
        """Smoothing starts anew where frames do not follow each other."""
        online = OnlinePerformance(self._trial.settings.positive_threshold_px)
        labels_px = [float(self._labels_px[recording][row]) for recording, row in frames]
        estimates_px = list(self._estimates_px(frames))
        for estimate_px, label_px in zip(estimates_px, labels_px, strict=True):
            online.update(estimate_px, label_px, online.positive_threshold_px)
        curve = roc_curve(estimates_px, labels_px, online.positive_threshold_px)
        return Score(
            n=online.n_samples,
            mse=online.mse_px2,
            mse_over_variance=online.mse_over_variance,
            auc=curve.auc,
            fpr=curve.fpr_at_tpr(WANTED_TPR),
        )

    def _estimates_px(self, frames: Frames) -> Iterator[float]:
        last = (-1, -1)
        for recording, row in frames:
            if (recording, row - 1) != last:
                self.learner.break_sequence()
            last = recording, row
            yield self.learner.predict(self._features_of(recording, row)).mono_px

    def _matcher(self, recording: int) -> StereoMatcher:
        if recording not in self._matchers:
            calibration = self._trial.recordings[recording].calibration
            self._matchers[recording] = StereoMatcher(self._plan.stereo, calibration)
        return self._matchers[recording]

    def _image(self, recording: int, row: int) -> Grey:
        eye = 0 if self._plan.learner.eye == "left" else 1
        return self._sized(self._images[recording][row, eye])

    def _sized(self, image: Grey) -> Grey:
        width_px = self._trial.variant.lab.image_width_px
        if width_px is None:
            return image
        size = width_px, round(width_px * image.shape[0] / image.shape[1])
        return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)

    def _features_of(self, recording: int, row: int) -> Features | None:
        if not self._keeps_features:
            return self.learner.observe(self._image(recording, row))
        if recording not in self._features:
            self._features[recording] = self._kept_features(recording)
        return self._features[recording].of(row, lambda: self._image(recording, row))

    @property
    def _keeps_features(self) -> bool:
        """Pixels would only be copied, patches at random places are new each time, and a map
        is made of the image."""
        settings = self._plan.learner
        fixed = settings.design.features != "pixels" and settings.textons.sampling == "grid"
        return fixed and settings.output == "scalar"

    def _kept_features(self, recording: int) -> KeptFeatures:
        """Learners with one dictionary share them."""
        state = self.learner.state()
        textons = [v.tobytes() for n, v in state.arrays.items() if n.startswith("textons.")]
        meaning = {k: v for k, v in state.meaning.items() if k not in NOT_OF_FEATURES}
        width_px = self._trial.variant.lab.image_width_px
        stored = self._trial.recordings[recording]
        path = stored.derived / f"features-{digest(meaning, width_px, *textons)}.npy"
        return KeptFeatures(path, len(stored), self.learner)

    def keep_features(self) -> None:
        """For other runs with the same dictionary."""
        for kept in self._features.values():
            kept.save()


def trials_of(
    study: Study,
    folds: Sequence[Fold],
    recordings: tuple[Stored, ...],
    dictionaries: dict[str, Stored],
) -> list[Trial]:
    """Every variant on every fold with every seed."""
    return [
        Trial(
            variant,
            study.settings,
            fold,
            seed,
            recordings,
            dictionaries.get(variant.lab.dictionary),
        )
        for variant in study.variants
        for fold in folds
        for seed in study.settings.seeds
    ]
