"""Learning from recordings, without a vehicle: the run behind ``companion learn``."""

import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from companion.camera.replay import Recording, TellsMotion
from companion.judging.performance import threshold_for_tpr_px
from companion.kernel.messages import StereoFrame
from companion.learning.learner import Learner
from companion.learning.learner_settings import LearnerSettings
from companion.learning_report import LearningReport, Scores
from companion.modelfile import load_dictionary
from companion.threads import use_one_thread
from companion.vision.cells import cell_labels
from companion.vision.parallax import Parallax
from companion.vision.stereo import StereoMatcher, StereoSettings


class LearningPlan(Protocol):
    """The part of a plan that learning needs."""

    @property
    def seed(self) -> int: ...
    @property
    def stereo(self) -> StereoSettings: ...
    @property
    def learner(self) -> LearnerSettings: ...


class Session:
    """A learner going through recordings; remembers every frame it scored."""

    def __init__(self, plan: LearningPlan, folder: Path = Path()) -> None:
        self._plan = plan
        path = plan.learner.dictionary
        dictionary = load_dictionary(folder / path) if path else None
        use_one_thread()
        self.learner = Learner(plan.learner, np.random.default_rng(plan.seed), dictionary)
        self.n_frames = 0
        self.n_train = 0
        self.scores = Scores()

    def run(self, recordings: Iterable[Recording]) -> None:
        """Predicts each frame first, then learns from it unless the learner is frozen."""
        for recording in recordings:
            matcher = StereoMatcher(
                self._plan.stereo, recording.calibration, self._plan.learner.label
            )
            self.learner.break_sequence()
            nearness_per_m = self._nearness_per_m(recording)
            for frame in recording:
                self._step(frame, matcher, nearness_per_m(frame))

    def forget_scores(self) -> None:
        """What follows is scored on its own."""
        self.scores = Scores()

    def threshold_px(self, positive_threshold_px: float) -> float:
        """As in flight: fixed, or chosen on the frames scored so far where they have positives.

        A recording has no approaches to weigh a risk on: "risk" is as "fixed" here.
        """
        settings = self._plan.learner
        fixed_px = settings.fixed_threshold_px(positive_threshold_px)
        if settings.threshold != "roc":
            return fixed_px
        chosen_px = threshold_for_tpr_px(
            self.scores.mono_px,
            self.scores.stereo_px,
            positive_threshold_px,
            settings.wanted_tpr,
        )
        return fixed_px if math.isnan(chosen_px) else chosen_px

    def report(self, positive_threshold_px: float, threshold_px: float) -> LearningReport:
        """The figures of the frames scored since the scores were last forgotten."""
        return self.scores.report(
            positive_threshold_px, threshold_px, n_train=self.n_train, n_frames=self.n_frames
        )

    def _nearness_per_m(self, recording: Recording) -> Callable[[StereoFrame], float]:
        """By the vehicle's own motion, for a learner that looks at it; NaN where nobody told it."""
        settings = self._plan.learner
        if not (settings.design.motion and isinstance(recording, TellsMotion)):
            return lambda frame: math.nan
        parallax = Parallax(recording.calibration, settings.eye)

        def observe(frame: StereoFrame) -> float:
            telemetry = recording.telemetry_at(frame.stamp_ns)
            return parallax.observe(self.learner.image_of(frame), frame.stamp_ns, telemetry)

        return observe

    def _step(self, frame: StereoFrame, matcher: StereoMatcher, nearness_per_m: float) -> None:
        disparity_px = matcher.match(frame.left, frame.right).disparity_px
        features = self.learner.observe(self.learner.image_of(frame), nearness_per_m)
        mono = self.learner.predict(features)
        self.n_train += self.learner.learn(features, disparity_px, matcher.last_map)
        self.n_frames += 1
        cells_px = None if mono.map_px is None else cell_labels(matcher.last_map()).disparity_px
        self.scores.add(mono, disparity_px, cells_px)


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
