"""Learning from recordings, without a vehicle: the run behind ``companion learn``."""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Protocol

import msgspec
import numpy as np

from companion.camera.replay import Recording
from companion.kernel.messages import StereoFrame
from companion.learner import Learner
from companion.learner_settings import LearnerSettings
from companion.modelfile import load_dictionary
from companion.performance import OnlinePerformance, roc_curve, threshold_for_tpr_px
from companion.stereo import StereoMatcher, StereoSettings
from companion.threads import use_one_thread

WANTED_TPR = 0.96
"""Where the paper reports its false positive rate (section IV)."""


class LearningPlan(Protocol):
    """The part of a plan that learning needs."""

    @property
    def seed(self) -> int: ...
    @property
    def stereo(self) -> StereoSettings: ...
    @property
    def learner(self) -> LearnerSettings: ...


class LearningReport(msgspec.Struct, frozen=True, kw_only=True):
    """One eye's estimate against stereo's λ; NaN where nothing defines a figure."""

    mse: float
    """Pixels squared."""
    mse_over_variance: float
    """Over the variance of stereo's λ: 1 is what always answering its mean would score."""
    auc: float
    tpr: float
    fpr: float
    threshold_px: float
    """Estimate above which tpr and fpr count a frame as detected."""
    fpr_at_tpr_0_96: float
    positive_threshold_px: float
    n_train: int
    """Frames learned from."""
    n_test: int
    """Frames scored: both stereo and one eye knew λ."""
    n_frames: int
    """Frames read, with those that taught the dictionary or had no λ."""


class Session:
    """A learner going through recordings; remembers (estimate, λ) of every frame it scored."""

    def __init__(self, plan: LearningPlan, folder: Path = Path()) -> None:
        self._plan = plan
        path = plan.learner.dictionary
        dictionary = load_dictionary(folder / path) if path else None
        use_one_thread()
        self.learner = Learner(plan.learner, np.random.default_rng(plan.seed), dictionary)
        self.n_frames = 0
        self.n_train = 0
        self.mono_px: list[float] = []
        self.stereo_px: list[float] = []

    def run(self, recordings: Iterable[Recording]) -> None:
        """Predicts each frame first, then learns from it unless the learner is frozen."""
        for recording in recordings:
            matcher = StereoMatcher(
                self._plan.stereo, recording.calibration, self._plan.learner.label
            )
            self.learner.break_sequence()
            for frame in recording:
                self._step(frame, matcher)

    def forget_scores(self) -> None:
        """What follows is scored on its own."""
        self.mono_px.clear()
        self.stereo_px.clear()

    def threshold_px(self, positive_threshold_px: float) -> float:
        """As in flight: fixed, or chosen on the frames scored so far where they have positives.

        A recording has no approaches to weigh a risk on: "risk" is as "fixed" here.
        """
        settings = self._plan.learner
        fixed_px = settings.fixed_threshold_px(positive_threshold_px)
        if settings.threshold != "roc":
            return fixed_px
        chosen_px = threshold_for_tpr_px(
            self.mono_px, self.stereo_px, positive_threshold_px, settings.wanted_tpr
        )
        return fixed_px if math.isnan(chosen_px) else chosen_px

    def report(self, positive_threshold_px: float, threshold_px: float) -> LearningReport:
        """The figures of the frames scored since the scores were last forgotten."""
        online = OnlinePerformance(positive_threshold_px)
        for mono_px, stereo_px in zip(self.mono_px, self.stereo_px, strict=True):
            online.update(mono_px, stereo_px, threshold_px)
        curve = roc_curve(self.mono_px, self.stereo_px, positive_threshold_px)
        return LearningReport(
            mse=online.mse_px2,
            mse_over_variance=online.mse_over_variance,
            auc=curve.auc,
            tpr=online.tpr,
            fpr=online.fpr,
            threshold_px=threshold_px,
            fpr_at_tpr_0_96=curve.fpr_at_tpr(WANTED_TPR),
            positive_threshold_px=positive_threshold_px,
            n_train=self.n_train,
            n_test=online.n_samples,
            n_frames=self.n_frames,
        )

    def _step(self, frame: StereoFrame, matcher: StereoMatcher) -> None:
        disparity_px = matcher.match(frame.left, frame.right).disparity_px
        features = self.learner.observe(self.learner.image_of(frame))
        mono_px = self.learner.predict(features).mono_px
        self.n_train += self.learner.learn(features, disparity_px, matcher.last_map)
        self.n_frames += 1
        if not (math.isnan(mono_px) or math.isnan(disparity_px)):
            self.mono_px.append(mono_px)
            self.stereo_px.append(disparity_px)


def run_prequential(
    recordings: Sequence[Recording],
    plan: LearningPlan,
    positive_threshold_px: float,
    folder: Path = Path(),
) -> LearningReport:
    """Goes through the recordings once, in the order given, learning all the way.

    With a threshold from the ROC, it is the one that the whole run would have chosen. A relative
    ``learner.dictionary`` lies in ``folder``.
    """
    session = Session(plan, folder)
    session.run(recordings)
    return session.report(positive_threshold_px, session.threshold_px(positive_threshold_px))


def run_train_test(
    train: Sequence[Recording],
    test: Sequence[Recording],
    plan: LearningPlan,
    positive_threshold_px: float,
    folder: Path = Path(),
) -> LearningReport:
    """Learns on ``train``, freezes, and reports on ``test`` alone; ``folder`` as above."""
    session = Session(plan, folder)
    session.run(train)
    threshold_px = session.threshold_px(positive_threshold_px)
    session.learner.freeze()
    session.forget_scores()
    session.n_frames = 0
    session.run(test)
    return session.report(positive_threshold_px, threshold_px)
