"""What one frame says: stereo's λ from the eyes that are sound, and one eye's estimate of it."""

import math
from typing import NamedTuple

from companion.features import Features, Grey
from companion.health import CameraHealth, Look
from companion.kernel.messages import Percept, StereoFrame
from companion.learner import UNKNOWN, Learner, MonoEstimate
from companion.stereo import StereoMatcher, StereoResult

UNMATCHED = StereoResult(math.nan, 0.0, math.nan, math.nan)


class Seen(NamedTuple):
    """A percept, and the features that can be learned from where its λ is known."""

    percept: Percept
    features: Features | None


class Perception:
    """Estimates before it is learned from what is seen: estimates stay prequential."""

    def __init__(self, matcher: StereoMatcher, learner: Learner, health: CameraHealth) -> None:
        self._matcher = matcher
        self._learner = learner
        self._health = health
        self._eye: str = learner.settings.eye

    def see(self, frame: StereoFrame, arrived_s: float = math.nan) -> Seen:
        """See CameraHealth.look. Raises CameraError for a frame of the wrong size."""
        usable = self._health.look(frame, arrived_s)
        stereo = self._match(frame, usable)
        image = self._image(frame, usable)
        features, mono = self._estimate(image) if image is not None else (None, UNKNOWN)
        percept = Percept(
            stamp_ns=frame.stamp_ns,
            stereo_px=stereo.disparity_px,
            stereo_valid_norm=stereo.valid_norm,
            mono_px=mono.mono_px,
            mono_std_px=mono.std_px,
            mono_novelty=mono.novelty,
        )
        return Seen(percept, features)

    def _match(self, frame: StereoFrame, usable: Look) -> StereoResult:
        """Unknown unless both eyes are sound and a pair."""
        if not usable.both:
            return UNMATCHED
        stereo = self._matcher.match(frame.left, frame.right)
        if self._health.compare(self._matcher.last_matches(), stereo.valid_norm):
            return stereo
        return UNMATCHED._replace(valid_norm=stereo.valid_norm)

    def _image(self, frame: StereoFrame, usable: Look) -> Grey | None:
        """Of the learner's own eye; of the other one where that is all there is.

        A dictionary is learned from the own eye alone.
        """
        left_first = self._learner.settings.eye == "left"
        if usable.left and (left_first or not usable.right):
            eye, image = "left", frame.left
        elif usable.right:
            eye, image = "right", frame.right
        else:
            return None
        if eye != self._learner.settings.eye and not self._learner.ready:
            return None
        if eye != self._eye:
            self._learner.break_sequence()
            self._eye = eye
        return image

    def _estimate(self, image: Grey) -> tuple[Features | None, MonoEstimate]:
        features = self._learner.observe(image)
        return features, self._learner.predict(features)
