"""Persistent self-supervised learning: the estimate f(x_f) of λ from one eye (section III).

A learner sees each image three times: ``observe`` turns it into features (or, while the dictionary
is young, learns textons from it), ``predict`` estimates λ from them, ``learn`` takes stereo's λ as
the target. What it has learned stays when stereo is gone.
"""

import math
from collections import deque
from typing import NamedTuple, Self

import msgspec
import numpy as np
from numpy.typing import NDArray

from companion.kernel.errors import PlanError
from companion.kernel.messages import StereoFrame
from companion.kernel.parts import Arrays, part, refuse_misfits, whole
from companion.learning.estimators import (
    Estimate,
    MapOf,
    Seen,
    make_estimator,
)
from companion.learning.fusion import Estimate as Fused
from companion.learning.learner_settings import LearnerSettings
from companion.learning.motion import MotionScale, reconcile
from companion.learning.novelty import Novelty
from companion.vision.features import (
    OF_VIEWS,
    EntropyFeatures,
    Extractor,
    Features,
    Grey,
    TextonFeatures,
    ViewFeatures,
)
from companion.vision.textons import TextonDictionary


class MonoEstimate(NamedTuple):
    """λ as one eye sees it; NaN while unknown."""

    mono_px: float
    """Averaged over the last frames."""
    std_px: float
    """Averaged over the same frames."""
    novelty: float
    """Of the newest frame alone: see companion.learning.novelty."""
    map_px: NDArray[np.float32] | None = None
    """λ of each cell (vision.cells) of the newest frame, where ``learner.output`` is "map"."""
    motion_px: float = math.nan
    """λ of the newest frame by its own motion alone."""


class _Lesson(NamedTuple):
    """What a frame teaches once it has waited."""

    seen: Seen
    disparity_px: float
    map_of: MapOf | None

    @classmethod
    def of(cls, seen: Seen, disparity_px: float, map_of: MapOf | None) -> Self:
        """With a map made now, from the pair just matched."""
        if map_of is None:
            return cls(seen, disparity_px, None)
        map_px = map_of()
        return cls(seen, disparity_px, lambda: map_px)


class LearnerState(NamedTuple):
    """All that a learner learned, as plain data."""

    arrays: dict[str, NDArray[np.generic]]
    meaning: dict[str, str | int | float]
    """Settings that the arrays depend on, by their path in a plan."""


UNKNOWN = MonoEstimate(math.nan, math.nan, math.nan)
MOST_GREY = 255.0
"""No texton of an image is brighter, darker or steeper."""


class Learner:
    """Dictionary, samples and regressor of one eye."""

    def __init__(
        self,
        settings: LearnerSettings,
        rng: np.random.Generator,
        dictionary: TextonDictionary | None = None,
    ) -> None:
        self.settings = settings
        self.frozen = False
        self._extractor = _extractor(settings, rng)
        if dictionary is not None:
            self._extractor.adopt(dictionary)
        self._estimator = make_estimator(settings, self._extractor, rng.spawn(1)[0])
        self._motion = MotionScale()
        self._novelty = Novelty()
        self._observed: Seen | None = None
        self._waiting: deque[_Lesson] = deque()
        self._recent: deque[Estimate] = deque(maxlen=settings.smooth_frames)

    @property
    def ready(self) -> bool:
        """True when there is a dictionary, so that images become features."""
        return self._extractor.ready

    @property
    def dictionary(self) -> TextonDictionary | None:
        return self._extractor.dictionary

    def image_of(self, frame: StereoFrame) -> Grey:
        """The eye that this learner looks through."""
        return frame.left if self.settings.eye == "left" else frame.right

    def observe(self, image: Grey, nearness_per_m: float = math.nan) -> Features | None:
        """Features (n_features,) of a raw image; None while the dictionary is being learned.

        ``nearness_per_m``: by companion.vision.parallax, for a learner that looks at motion.
        """
        features = self._extractor.observe(image, self.frozen)
        self._observed = None if features is None else Seen(features, image, nearness_per_m)
        return features

    def predict(self, features: Features | None) -> MonoEstimate:
        """Estimate of λ, averaged with those of the last frames."""
        if features is None or not self._estimator.trained:
            return UNKNOWN
        seen = self._seen(features)
        newest = self._estimator.estimate(seen)
        motion = self._motion.estimate(seen.nearness_per_m)
        fused = reconcile(Fused(newest.mono_px, newest.std_px), motion)
        newest = newest._replace(mono_px=fused.disparity_px, std_px=fused.std_px)
        self._recent.append(newest)
        n_recent = len(self._recent)
        return MonoEstimate(
            sum(estimate.mono_px for estimate in self._recent) / n_recent,
            sum(estimate.std_px for estimate in self._recent) / n_recent,
            self._novelty.of(features),
            newest.map_px,
            motion.disparity_px,
        )

    def learn(
        self, features: Features | None, disparity_px: float, map_of: MapOf | None = None
    ) -> bool:
        """Takes stereo's λ as the target for ``features``; True if it was a usable sample.

        With ``map_of``, further views of the image just observed are learned from too. All wait
        for as many frames as the settings say; what is learned now is then an older frame.
        """
        if self.frozen or features is None or math.isnan(disparity_px):
            return False
        seen = self._seen(features)
        if not self.settings.delay_frames:
            return self._teach(seen, disparity_px, map_of)
        self._waiting.append(_Lesson.of(seen, disparity_px, map_of if self._uses_maps else None))
        if len(self._waiting) <= self.settings.delay_frames:
            return False
        return self._teach(*self._waiting.popleft())

    def _teach(self, seen: Seen, disparity_px: float, map_of: MapOf | None) -> bool:
        if not self._estimator.learn(seen, disparity_px, map_of):
            return False
        self._motion.learn(seen.nearness_per_m, disparity_px)
        self._novelty.learn(seen.features)
        return True

    @property
    def _uses_maps(self) -> bool:
        return bool(self.settings.design.views) or self.settings.output == "map"

    def _seen(self, features: Features) -> Seen:
        """With the image, if it is the one just observed."""
        if self._observed is not None and self._observed.features is features:
            return self._observed
        return Seen(features, None)

    def freeze(self) -> None:
        """Nothing is learned from here on, not even what still waits."""
        self.frozen = True

    def break_sequence(self) -> None:
        """The next image does not follow the last one: smoothing starts anew."""
        self._recent.clear()

    def state(self) -> LearnerState:
        """All that was learned; a dictionary half learned is not part of it."""
        arrays = whole(
            estimator=self._estimator.state(),
            motion=self._motion.state(),
            novelty=self._novelty.state(),
            textons=self.dictionary._asdict() if self.dictionary is not None else {},
        )
        return LearnerState(arrays, _meaning_of_samples(self.settings))

    def restore(self, state: LearnerState) -> Self:
        """Takes up where ``state`` was taken. Raises PlanError where samples mean another thing."""
        for key, wanted in _meaning_of_samples(self.settings).items():
            learned = state.meaning.get(key)
            if learned != wanted:
                raise PlanError(
                    f"saved model was learned with {key} = {learned!r}; the plan says {wanted!r}"
                )
        dictionary = dictionary_of(state)
        try:
            self._adopt(state, dictionary)
        except (ArithmeticError, LookupError, TypeError, ValueError) as error:
            raise PlanError(f"saved model does not fit together: {error}") from error
        return self

    def _adopt(self, state: LearnerState, dictionary: TextonDictionary | None) -> None:
        """Raises whatever the arrays' misfit leads to, now rather than at the first image."""
        if dictionary is not None:
            self._extractor.adopt(dictionary)
        self._recent.clear()
        learned = part(state.arrays, "estimator")
        if not learned:
            return
        like, seen = _one_lesson(self.settings, dictionary)
        refuse_misfits(state.arrays, like)
        self._estimator.restore(learned)
        self._motion.restore(part(state.arrays, "motion"))
        self._novelty = Novelty.restored(part(state.arrays, "novelty"))
        answer = self._estimator.estimate(seen)
        if not math.isfinite(answer.mono_px):
            raise ValueError("an empty image has no λ")


def _one_lesson(
    settings: LearnerSettings, dictionary: TextonDictionary | None
) -> tuple[Arrays, Seen]:
    """What a learner holds after one empty image, and what it saw."""
    settings = msgspec.structs.replace(settings, delay_frames=0)
    learner = Learner(settings, np.random.default_rng(0), dictionary)
    image = np.zeros((96, 128), dtype=np.uint8)
    features = learner.observe(image)
    if features is None:
        raise ValueError("samples without textons")
    map_px = np.ones(image.shape, dtype=np.float32)
    learner.learn(features, 1.0, (lambda: map_px) if settings.output == "map" else None)
    return learner.state().arrays, Seen(features, image)


def _extractor(settings: LearnerSettings, rng: np.random.Generator) -> Extractor:
    kind = settings.design.features
    if kind in OF_VIEWS:
        return ViewFeatures(kind)
    of_textons = EntropyFeatures if kind == "entropy" else TextonFeatures
    return of_textons(settings.textons, settings.entropy_scale, rng)


def dictionary_of(state: LearnerState) -> TextonDictionary | None:
    """The textons in a learner's state, if it has any. Raises PlanError for what are none."""
    if "textons.intensity" not in state.arrays:
        return None
    try:
        found = [state.arrays[f"textons.{kind}"] for kind in TextonDictionary._fields]
        with np.errstate(all="ignore"):  # judged below
            textons = TextonDictionary(*(np.asarray(part, dtype=np.float32) for part in found))
    except (KeyError, TypeError, ValueError) as error:
        raise PlanError(f"saved model: its textons are not readable: {error}") from error
    if any(part.ndim != 2 or not (np.abs(part) <= MOST_GREY).all() for part in textons):
        raise PlanError("saved model: its textons are no patches of an image")
    return textons


def _meaning_of_samples(settings: LearnerSettings) -> dict[str, str | int | float]:
    """The settings on which features and targets depend."""
    textons, design = settings.textons, settings.design
    common: dict[str, str | int | float] = {
        "learner.features": design.features,
        "learner.regressor": design.regressor,
        "learner.target": design.target,
        "learner.output": settings.output,
        "learner.eye": settings.eye,
        "learner.label": settings.label,
    }
    if design.features in OF_VIEWS:
        return common
    return common | {
        "learner.entropy_scale": settings.entropy_scale,
        "learner.textons.patch_px": textons.patch_px,
        "learner.textons.patches": textons.patches,
        "learner.textons.intensity": textons.intensity,
        "learner.textons.gradient": textons.gradient,
        "learner.textons.sampling": textons.sampling,
    }
