"""Persistent self-supervised learning: the estimate f(x_f) of λ from one eye (section III).

A learner sees each image three times: ``observe`` turns it into features (or, while the dictionary
is young, learns textons from it), ``predict`` estimates λ from them, ``learn`` takes stereo's λ as
the target. What it has learned stays when stereo is gone.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from companion import gradients, regressors
from companion.features import Extractor, Features, GradientFeatures, Grey, TextonFeatures
from companion.kernel.errors import PlanError
from companion.kernel.messages import StereoFrame
from companion.learner_settings import LearnerSettings
from companion.novelty import Novelty
from companion.textons import TextonDictionary
from companion.views import views_of

MapOf = Callable[[], NDArray[np.float32]]
"""Gives the disparity map (height, width) of the pair just matched, NaN where unmatched."""

LOG_OFFSET_PX, LOG_FLOOR_PX = 0.5, -0.4
"""log(λ + offset) is learned, of λ no less than the floor; a poor calibration makes λ negative."""


class MonoEstimate(NamedTuple):
    """λ as one eye sees it; NaN while unknown."""

    mono_px: float
    """Averaged over the last frames."""
    std_px: float
    """Averaged over the same frames."""
    novelty: float
    """Of the newest frame alone: see companion.novelty."""


class LearnerState(NamedTuple):
    """All that a learner learned, as plain data."""

    arrays: dict[str, NDArray[np.generic]]
    meaning: dict[str, str | int | float]
    """Settings that the arrays depend on, by their path in a plan."""


UNKNOWN = MonoEstimate(math.nan, math.nan, math.nan)


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
        self._trained = False
        self._design = settings.design
        self._extractor = _extractor(settings, rng)
        if dictionary is not None:
            self._extractor.adopt(dictionary)
        self._views_rng = rng.spawn(1)[0]
        parameters = regressors.RegressorSettings(
            k=settings.k,
            capacity=settings.capacity,
            seed=int(self._views_rng.integers(2**31)),
        )
        self._regressor = regressors.make(self._design.regressor, parameters)
        self._range_px = np.array([math.inf, -math.inf])
        self._novelty = Novelty()
        self._observed: tuple[Grey, Features] | None = None
        self._recent: deque[tuple[float, float]] = deque(maxlen=settings.smooth_frames)

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

    def observe(self, image: Grey) -> Features | None:
        """Features (n_features,) of a raw image; None while the dictionary is being learned."""
        features = self._extractor.observe(image, self.frozen)
        self._observed = None if features is None else (image, features)
        return features

    def predict(self, features: Features | None) -> MonoEstimate:
        """Estimate of λ, averaged with those of the last frames."""
        if features is None or not self._trained:
            return UNKNOWN
        mean, std = self._regressor.predict(features[np.newaxis], return_std=True)
        self._recent.append(self._in_pixels(float(mean[0]), float(std[0])))
        n_recent = len(self._recent)
        return MonoEstimate(
            sum(mean_px for mean_px, _ in self._recent) / n_recent,
            sum(std_px for _, std_px in self._recent) / n_recent,
            self._novelty.of(features),
        )

    def learn(
        self, features: Features | None, disparity_px: float, map_of: MapOf | None = None
    ) -> bool:
        """Takes stereo's λ as the target for ``features``; True if it was a usable sample.

        With ``map_of``, further views of the image just observed are learned from too.
        """
        if self.frozen or features is None or math.isnan(disparity_px):
            return False
        samples, disparities_px = [features], [disparity_px]
        if self._design.views and map_of and self._observed and self._observed[1] is features:
            image, n_views = self._observed[0], self._design.views
            for view, view_px in views_of(image, map_of(), disparity_px, n_views, self._views_rng):
                samples.append(gradients.encode(view))
                disparities_px.append(view_px)
        self._regressor.partial_fit(np.stack(samples), self._targets(np.array(disparities_px)))
        self._novelty.learn(features)
        self._range_px[0] = min(self._range_px[0], disparity_px)
        self._range_px[1] = max(self._range_px[1], disparity_px)
        self._trained = True
        return True

    def _targets(self, disparities_px: NDArray[np.float64]) -> NDArray[np.float64]:
        if self._design.target == "linear":
            return disparities_px
        return np.log(np.maximum(disparities_px, LOG_FLOOR_PX) + LOG_OFFSET_PX)

    def _in_pixels(self, mean: float, std: float) -> tuple[float, float]:
        """The regressor's answer as λ, within what stereo has reported so far."""
        least_px, most_px = self._range_px
        if self._design.target == "log":
            mean = math.exp(min(mean, math.log(most_px + 1.0)))
            mean, std = mean - LOG_OFFSET_PX, mean * std
        return float(min(max(mean, least_px), most_px)), std

    def freeze(self) -> None:
        """Nothing is learned from here on."""
        self.frozen = True

    def break_sequence(self) -> None:
        """The next image does not follow the last one: smoothing starts anew."""
        self._recent.clear()

    def state(self) -> LearnerState:
        """All that was learned; a dictionary half learned is not part of it."""
        arrays = _whole(
            regressor=self._regressor.state(),
            novelty=self._novelty.state(),
            textons=self.dictionary._asdict() if self.dictionary is not None else {},
        )
        if self._trained:
            arrays["range_px"] = self._range_px.copy()
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
        if dictionary is not None:
            self._extractor.adopt(dictionary)
        samples = _part(state, "regressor")
        self._regressor.restore(samples)
        self._novelty = Novelty.restored(_part(state, "novelty"))
        self._trained = bool(samples)
        if samples:
            self._range_px = np.array(state.arrays["range_px"], dtype=np.float64)
        self._recent.clear()
        return self


def _extractor(settings: LearnerSettings, rng: np.random.Generator) -> Extractor:
    if settings.design.features == "gradients":
        return GradientFeatures()
    return TextonFeatures(settings.textons, settings.entropy_scale, rng)


def _part(state: LearnerState, name: str) -> dict[str, NDArray[np.generic]]:
    """The arrays that ``_whole`` put under this name."""
    prefix = f"{name}."
    return {
        key.removeprefix(prefix): values
        for key, values in state.arrays.items()
        if key.startswith(prefix)
    }


def _whole(**parts: Mapping[str, NDArray[np.generic]]) -> dict[str, NDArray[np.generic]]:
    """The parts' arrays, each under its part's name."""
    return {f"{name}.{key}": values for name, part in parts.items() for key, values in part.items()}


def dictionary_of(state: LearnerState) -> TextonDictionary | None:
    """The textons in a learner's state, if it has any."""
    if "textons.intensity" not in state.arrays:
        return None
    return TextonDictionary(
        np.asarray(state.arrays["textons.intensity"], dtype=np.float32),
        np.asarray(state.arrays["textons.gradient"], dtype=np.float32),
    )


def _meaning_of_samples(settings: LearnerSettings) -> dict[str, str | int | float]:
    """The settings on which features and targets depend."""
    textons, design = settings.textons, settings.design
    common: dict[str, str | int | float] = {
        "learner.features": design.features,
        "learner.regressor": design.regressor,
        "learner.target": design.target,
        "learner.eye": settings.eye,
        "learner.label": settings.label,
    }
    if design.features == "gradients":
        return common
    return common | {
        "learner.entropy_scale": settings.entropy_scale,
        "learner.textons.patch_px": textons.patch_px,
        "learner.textons.patches": textons.patches,
        "learner.textons.intensity": textons.intensity,
        "learner.textons.gradient": textons.gradient,
        "learner.textons.sampling": textons.sampling,
    }
