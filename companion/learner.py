"""Persistent self-supervised learning: the estimate f(x_f) of λ from one eye (section III).

A learner sees each image three times: ``observe`` turns it into features (or, while the dictionary
is young, learns textons from it), ``predict`` estimates λ from them, ``learn`` takes stereo's λ as
the target. What it has learned stays when stereo is gone.
"""

import math
from collections import deque
from typing import Annotated, Literal, NamedTuple, Self

import numpy as np
from msgspec import Meta, field
from numpy.typing import NDArray

from companion import regressors
from companion.kernel.errors import PlanError
from companion.kernel.messages import StereoFrame
from companion.kernel.settings import Settings
from companion.stereo import Label
from companion.textons import TextonDictionary, TextonEncoder, TextonSettings, TextonTrainer

Grey = NDArray[np.uint8]
Features = NDArray[np.float32]

TABLE_I = {
    "k": 5,
    "smooth_frames": 4,
    "textons.patch_px": 5,
    "textons.patches": 500,
    "textons.intensity": 10,
    "textons.gradient": 10,
}
"""The paper's Table I, by the path of the setting."""


class LearnerSettings(Settings, frozen=True):
    """What is learned, from which eye, and when the estimate counts as an obstacle."""

    preset: Literal["paper", "none"] = "paper"
    """"paper" holds k, smooth_frames and the textons to Table I; "none" leaves them free."""
    regressor: str = "knn"
    eye: Literal["left", "right"] = "left"
    label: Label = "mean"
    """What stereo's λ is: mean of the disparities, or the value that the top 24 % exceed."""
    threshold: Literal["fixed", "roc", "risk"] = "fixed"
    """"roc" takes the highest threshold that reached ``wanted_tpr`` on the samples so far; "risk"
    one that keeps the two wishes below, the first of them before the second."""
    threshold_px: Annotated[float, Meta(gt=0.0)] | None = None
    """The fixed threshold; none means ``threshold_ratio`` times stereo's."""
    threshold_ratio: Annotated[float, Meta(gt=0.0)] = 1.0
    """Below 1, one eye turns earlier than two (section III-E), and so learns what is near."""
    wanted_tpr: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.96
    wanted_collision_probability: Annotated[float, Meta(gt=0.0, lt=1.0)] = 1e-3
    """Of one approach to an obstacle."""
    wanted_spurious_turns_per_m: Annotated[float, Meta(gt=0.0)] = 0.1
    detection_distance_m: Annotated[float, Meta(gt=0.0)] = 1.0
    """An obstacle that is detected only nearer than this counts as a collision."""
    k: Annotated[int, Meta(ge=1, le=64)] = 5
    smooth_frames: Annotated[int, Meta(ge=1, le=100)] = 4
    entropy_scale: Annotated[float, Meta(ge=0.0)] = 0.1
    """Weight of the entropy against the histogram's bins. Plain bits (1) would outweigh them all;
    0.1 brings both to the same range. On recorded flights neither generalises better."""
    capacity: Annotated[int, Meta(ge=1, le=10_000_000)] = 100_000
    """Samples kept; beyond it the oldest is replaced."""
    dictionary: str | None = None
    """File with a saved model whose textons are used; none learns them in flight."""
    textons: TextonSettings = field(default_factory=TextonSettings)

    def __post_init__(self) -> None:
        if self.preset != "paper":
            return
        for path, wanted in TABLE_I.items():
            section, _, key = path.rpartition(".")
            value = getattr(self.textons if section else self, key)
            if value != wanted:
                raise ValueError(
                    f'{path} = {value} contradicts preset "paper", where it is {wanted}; '
                    'preset "none" allows it'
                )

    def fixed_threshold_px(self, stereo_threshold_px: float) -> float:
        """λ above which one eye turns, unless the ROC says better."""
        if self.threshold_px is not None:
            return self.threshold_px
        return self.threshold_ratio * stereo_threshold_px


class MonoEstimate(NamedTuple):
    """λ as one eye sees it, averaged over the last frames; NaN while unknown."""

    mono_px: float
    std_px: float
    """Spread of the neighbours' targets, averaged over the same frames."""


class LearnerState(NamedTuple):
    """All that a learner learned, as plain data."""

    arrays: dict[str, NDArray[np.generic]]
    meaning: dict[str, str | int | float]
    """Settings that the arrays depend on, by their path in a plan."""


UNKNOWN = MonoEstimate(math.nan, math.nan)


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
        self._training_rng, self._sampling_rng = rng.spawn(2)
        self._trainer = TextonTrainer(settings.textons, self._training_rng)
        self._encoder = None if dictionary is None else self._make_encoder(dictionary)
        parameters = regressors.RegressorSettings(k=settings.k, capacity=settings.capacity)
        self._regressor = regressors.make(settings.regressor, parameters)
        self._recent: deque[MonoEstimate] = deque(maxlen=settings.smooth_frames)

    @property
    def ready(self) -> bool:
        """True when there is a dictionary, so that images become features."""
        return self._encoder is not None

    @property
    def dictionary(self) -> TextonDictionary | None:
        return self._encoder.dictionary if self._encoder else None

    def image_of(self, frame: StereoFrame) -> Grey:
        """The eye that this learner looks through."""
        return frame.left if self.settings.eye == "left" else frame.right

    def observe(self, image: Grey) -> Features | None:
        """Features (n_features,) of a raw image; None while the dictionary is being learned."""
        if self._encoder is not None:
            return self._encoder.encode(image)
        if not self.frozen:
            self._trainer.update(image)
            if self._trainer.finished:
                self._encoder = self._make_encoder(self._trainer.dictionary)
        return None

    def predict(self, features: Features | None) -> MonoEstimate:
        """Estimate of λ, averaged with those of the last frames."""
        if features is None or not self._trained:
            return UNKNOWN
        mono_px, std_px = self._regressor.predict(features[np.newaxis], return_std=True)
        self._recent.append(MonoEstimate(float(mono_px[0]), float(std_px[0])))
        n_recent = len(self._recent)
        return MonoEstimate(
            sum(estimate.mono_px for estimate in self._recent) / n_recent,
            sum(estimate.std_px for estimate in self._recent) / n_recent,
        )

    def learn(self, features: Features | None, disparity_px: float) -> bool:
        """Takes stereo's λ as the target for ``features``; True if it was a usable sample."""
        if self.frozen or features is None or math.isnan(disparity_px):
            return False
        self._regressor.partial_fit(features[np.newaxis], np.array([disparity_px]))
        self._trained = True
        return True

    def freeze(self) -> None:
        """Nothing is learned from here on."""
        self.frozen = True

    def break_sequence(self) -> None:
        """The next image does not follow the last one: smoothing starts anew."""
        self._recent.clear()

    def state(self) -> LearnerState:
        """All that was learned; a dictionary half learned is not part of it."""
        arrays = {f"regressor.{name}": values for name, values in self._regressor.state().items()}
        if self._encoder is not None:
            textons = self._encoder.dictionary._asdict()
            arrays |= {f"textons.{name}": values for name, values in textons.items()}
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
            self._encoder = self._make_encoder(dictionary)
        prefix = "regressor."
        samples = {
            name.removeprefix(prefix): values
            for name, values in state.arrays.items()
            if name.startswith(prefix)
        }
        self._regressor.restore(samples)
        self._trained = bool(samples)
        self._recent.clear()
        return self

    def _make_encoder(self, dictionary: TextonDictionary) -> TextonEncoder:
        textons = self.settings.textons
        n_values = textons.patch_px**2
        wanted = (textons.intensity, n_values), (textons.gradient, n_values)
        found = dictionary.intensity.shape, dictionary.gradient.shape
        if found != wanted:
            raise PlanError(
                f"dictionary has textons of shape {found[0]} and {found[1]}; "
                f"the settings ask for {wanted[0]} and {wanted[1]}"
            )
        scale = self.settings.entropy_scale
        return TextonEncoder(dictionary, textons, self._sampling_rng, scale)


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
    textons = settings.textons
    return {
        "learner.regressor": settings.regressor,
        "learner.eye": settings.eye,
        "learner.label": settings.label,
        "learner.entropy_scale": settings.entropy_scale,
        "learner.textons.patch_px": textons.patch_px,
        "learner.textons.patches": textons.patches,
        "learner.textons.intensity": textons.intensity,
        "learner.textons.gradient": textons.gradient,
        "learner.textons.sampling": textons.sampling,
    }
