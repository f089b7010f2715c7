"""θ: which cue flies (paper section III-A), by scheme and phase (section V), and the override."""

import math
from typing import Annotated, Literal, NamedTuple

import numpy as np
from msgspec import Meta

from companion.kernel.messages import Cue, Percept, Phase
from companion.kernel.settings import Settings

Scheme = Literal["pure_stereo", "cold_turkey", "dagger", "training_wheels"]
Duration = Annotated[float, Meta(ge=0, le=86_400)]


class ExperimentSettings(Settings, frozen=True):
    """``[experiment]``: who flies when (paper section V-A)."""

    scheme: Scheme = "training_wheels"
    initial_s: Duration = 60.0
    """Stereo flies, whatever the scheme."""
    learning_s: Duration = 240.0
    """The scheme decides who flies; the learner goes on learning."""
    test_s: Duration = 300.0
    """Learning is frozen; mono flies, but for ``pure_stereo``."""
    dagger_beta: Annotated[float, Meta(ge=0, le=1)] = 0.25
    """Probability that DAgger lets stereo fly a frame of the learning phase."""
    test_override: bool = True
    """False: once learning is over stereo is off for good, and mono must persist without it."""

    def phase_at(self, elapsed_s: float) -> Phase:
        """The phase at this time since the experiment began."""
        if elapsed_s < self.initial_s:
            return Phase.INITIAL
        if elapsed_s < self.initial_s + self.learning_s:
            return Phase.LEARNING
        if elapsed_s < self.initial_s + self.learning_s + self.test_s:
            return Phase.TEST
        return Phase.DONE


class Thresholds(NamedTuple):
    """λ above which each cue reports an obstacle, and above which stereo overrides mono."""

    stereo_px: float
    mono_px: float
    override_px: float


class Choice(NamedTuple):
    """The cue that flies and what it says; ``blocked`` is None while it does not know."""

    cue: Cue
    override: bool
    disparity_px: float
    threshold_px: float
    blocked: bool | None


class Switch:
    """Chooses the cue for each frame. An override lasts until stereo sees the way clear."""

    def __init__(self, settings: ExperimentSettings, rng: np.random.Generator) -> None:
        self.settings = settings
        self.overriding = False
        self._rng = rng

    def choose(
        self, percept: Percept, phase: Phase, thresholds: Thresholds, looks_ahead: bool
    ) -> Choice:
        """``looks_ahead``: the behaviour would act on this frame's obstacle (see Behaviour)."""
        scheduled = self._scheduled_cue(phase)
        alone = scheduled is Cue.MONO and phase is Phase.TEST and not self.settings.test_override
        if scheduled is Cue.STEREO or (math.isnan(percept.mono_px) and not alone):
            self.overriding = False
            return _choice(Cue.STEREO, False, percept.stereo_px, thresholds.stereo_px)
        self.overriding = not alone and self._override_needed(percept, thresholds, looks_ahead)
        if self.overriding:
            return _choice(Cue.STEREO, True, percept.stereo_px, thresholds.stereo_px)
        return _choice(Cue.MONO, False, percept.mono_px, thresholds.mono_px)

    def _scheduled_cue(self, phase: Phase) -> Cue:
        scheme = self.settings.scheme
        if scheme == "pure_stereo" or phase is Phase.INITIAL:
            return Cue.STEREO
        if phase is not Phase.LEARNING or scheme == "training_wheels":
            return Cue.MONO
        if scheme == "cold_turkey":
            return Cue.STEREO
        return Cue.STEREO if self._rng.random() < self.settings.dagger_beta else Cue.MONO

    def _override_needed(self, percept: Percept, thresholds: Thresholds, looks_ahead: bool) -> bool:
        """Begins when stereo is alarmed and mono silent; ends when stereo sees it clear.

        An unknown λ of stereo neither begins nor ends one.
        """
        if self.overriding:
            return not percept.stereo_px <= thresholds.stereo_px
        mono_silent = percept.mono_px <= thresholds.mono_px
        return looks_ahead and mono_silent and percept.stereo_px > thresholds.override_px


def _choice(cue: Cue, override: bool, disparity_px: float, threshold_px: float) -> Choice:
    blocked = None if math.isnan(disparity_px) else disparity_px > threshold_px
    return Choice(cue, override, disparity_px, threshold_px, blocked)
