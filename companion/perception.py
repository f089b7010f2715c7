"""What one frame says: stereo's λ from the eyes that are sound, and one eye's estimate of it."""

import math
from typing import NamedTuple

import msgspec

from companion.health import CameraHealth, Look
from companion.kernel.messages import Percept, StereoFrame, Telemetry
from companion.learning.fusion import UNKNOWN, Estimate, fuse, stereo_estimate
from companion.learning.learner import Learner
from companion.learning.spread import SpreadScale
from companion.vision.cells import CellMap
from companion.vision.features import Features, Grey
from companion.vision.parallax import Parallax
from companion.vision.stereo import StereoMatcher, StereoResult

UNMATCHED = StereoResult(math.nan, 0.0, math.nan, math.nan)


class Seen(NamedTuple):
    """A frame's percept, not yet fused, and what can be learned from it."""

    percept: Percept
    features: Features | None
    map_px: CellMap | None
    """Where the learner makes maps, and has learned to."""
    spread_px: float
    """Mono's spread as the learner gave it: the percept's is scaled to what errors showed."""


class Perception:
    """Each frame is seen, its cameras judged, and then settled: learned from, cues fused."""

    def __init__(self, matcher: StereoMatcher, learner: Learner, health: CameraHealth) -> None:
        self.samples_learned = 0
        self._matcher = matcher
        self._learner = learner
        self._health = health
        self._spread = SpreadScale()
        self._eye: str = learner.settings.eye
        moves = learner.settings.design.motion
        self._parallax = Parallax(matcher.calibration, self._eye) if moves else None

    def see(self, frame: StereoFrame, telemetry: Telemetry, arrived_s: float = math.nan) -> Seen:
        """Before anything is learned from it: estimates stay prequential.

        ``arrived_s``: as Pipeline.step has it. Raises CameraError for a frame of the wrong size.
        """
        # A simulator that cannot keep up lags behind our clock, a bad link behind the autopilot's.
        usable = self._health.look(frame, arrived_s, telemetry.stamp_ns * 1e-9)
        stereo = self._match(frame, usable)
        image = self._image(frame, usable)
        features = None if image is None else self._observe(image, frame.stamp_ns, telemetry)
        mono = self._learner.predict(features)
        percept = Percept(
            stamp_ns=frame.stamp_ns,
            stereo_px=stereo.disparity_px,
            stereo_valid_norm=stereo.valid_norm,
            mono_px=mono.mono_px,
            mono_std_px=self._spread.of(mono.std_px),
            mono_novelty=mono.novelty,
            motion_px=mono.motion_px,
        )
        return Seen(percept, features, mono.map_px, mono.std_px)

    def settle(self, seen: Seen, has_stereo: bool) -> Percept:
        """Learns from the frame where stereo may be learned from; the percept with the fused λ."""
        percept = seen.percept
        of_stereo = UNKNOWN
        if has_stereo:
            self.samples_learned += self._learner.learn(
                seen.features, percept.stereo_px, self._matcher.last_map
            )
            self._spread.learn(percept.mono_px - percept.stereo_px, seen.spread_px)
            of_stereo = stereo_estimate(percept.stereo_px, percept.stereo_valid_norm)
        fused = fuse(of_stereo, Estimate(percept.mono_px, percept.mono_std_px))
        return msgspec.structs.replace(
            percept, fused_px=fused.disparity_px, fused_std_px=fused.std_px
        )

    def _observe(self, image: Grey, stamp_ns: int, telemetry: Telemetry) -> Features | None:
        if self._parallax is None:
            return self._learner.observe(image)
        return self._learner.observe(image, self._parallax.observe(image, stamp_ns, telemetry))

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
            if self._parallax is not None:
                self._parallax = Parallax(self._matcher.calibration, eye)
        return image
