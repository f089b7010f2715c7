"""θ: which cue flies (paper section III-A), by scheme and phase (section V), and the override."""

import math
from typing import Annotated, Literal, NamedTuple

import numpy as np
from msgspec import Meta

from companion.kernel.messages import Availability, Cue, Percept, Phase, TrustStatus
from companion.kernel.settings import Settings

Scheme = Literal["pure_stereo", "cold_turkey", "dagger", "training_wheels", "auto", "fused"]
Duration = Annotated[float, Meta(ge=0, le=86_400)]

ALL_AVAILABLE = Availability()

PHASE_OF_TRUST = {
    TrustStatus.UNTRAINED: Phase.INITIAL,
    TrustStatus.LEARNING: Phase.LEARNING,
    TrustStatus.TRUSTED: Phase.TEST,
    TrustStatus.STALE: Phase.LEARNING,
}
"""The phases of the scheme "auto": mono flies once it is trusted, whenever that is."""


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
    """False: once learning is over stereo is off for good, and mono must persist without it. For
    "auto", whose learning is never over, that is once the first two durations have passed."""

    def phase_at(self, elapsed_s: float, trust: TrustStatus = TrustStatus.UNTRAINED) -> Phase:
        """The phase at this time since the experiment began; "auto" has them by trust."""
        if self.scheme == "auto":
            total_s = self.initial_s + self.learning_s + self.test_s
            return PHASE_OF_TRUST[trust] if elapsed_s < total_s else Phase.DONE
        if elapsed_s < self.initial_s:
            return Phase.INITIAL
        if elapsed_s < self.initial_s + self.learning_s:
            return Phase.LEARNING
        if elapsed_s < self.initial_s + self.learning_s + self.test_s:
            return Phase.TEST
        return Phase.DONE

    def stereo_is_over(self, elapsed_s: float) -> bool:
        """Whether "auto" must do without stereo from here on."""
        ends = self.scheme == "auto" and not self.test_override
        return ends and elapsed_s >= self.initial_s + self.learning_s


class Thresholds(NamedTuple):
    """λ above which each cue reports an obstacle, and above which stereo overrides mono."""

    stereo_px: float
    mono_px: float
    override_px: float
    caution_std: float = 0.0
    """Standard deviations that are added to mono's λ."""
    novelty: float = math.inf
    """Mono reports an obstacle also where nothing like the frame was learned."""


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
        self,
        percept: Percept,
        phase: Phase,
        thresholds: Thresholds,
        looks_ahead: bool,
        available: Availability = ALL_AVAILABLE,
        trust: TrustStatus = TrustStatus.UNTRAINED,
    ) -> Choice:
        """``looks_ahead``: the behaviour would act on this frame's obstacle (see Behaviour).

        Where stereo is not available, only an estimate that is trusted flies, and nothing
        overrides it; but in a test without override mono shall show what it can do.
        """
        scheduled = self._scheduled_cue(phase)
        alone = scheduled is Cue.MONO and phase is Phase.TEST and self._without_override
        if alone and (available.left or available.right):
            self.overriding = False
            return _mono_choice(percept, thresholds)
        if not available.stereo:
            self.overriding = False
            return _on_one_eye(percept, thresholds, available, trust)
        if scheduled is Cue.FUSED:
            self.overriding = False
            return _choice(Cue.FUSED, False, percept.fused_px, thresholds.stereo_px)
        if scheduled is Cue.STEREO or math.isnan(percept.mono_px):
            self.overriding = False
            return _choice(Cue.STEREO, False, percept.stereo_px, thresholds.stereo_px)
        self.overriding = self._override_needed(percept, thresholds, looks_ahead)
        if self.overriding:
            return _choice(Cue.STEREO, True, percept.stereo_px, thresholds.stereo_px)
        return _mono_choice(percept, thresholds)

    @property
    def _without_override(self) -> bool:
        """Of the paper's schemes; for "auto" stereo is not available then."""
        return not self.settings.test_override and self.settings.scheme != "auto"

    def _scheduled_cue(self, phase: Phase) -> Cue:
        scheme = self.settings.scheme
        if scheme == "pure_stereo" or phase is Phase.INITIAL:
            return Cue.STEREO
        if scheme == "fused":
            return Cue.FUSED
        if phase is not Phase.LEARNING or scheme == "training_wheels":
            return Cue.MONO
        if scheme in ("cold_turkey", "auto"):
            return Cue.STEREO
        return Cue.STEREO if self._rng.random() < self.settings.dagger_beta else Cue.MONO

    def _override_needed(self, percept: Percept, thresholds: Thresholds, looks_ahead: bool) -> bool:
        """Begins when stereo is alarmed and mono silent; ends when stereo sees it clear.

        An unknown λ of stereo neither begins nor ends one.
        """
        if self.overriding:
            return not percept.stereo_px <= thresholds.stereo_px
        mono_silent = _mono_choice(percept, thresholds).blocked is False
        return looks_ahead and mono_silent and percept.stereo_px > thresholds.override_px


def _on_one_eye(
    percept: Percept, thresholds: Thresholds, available: Availability, trust: TrustStatus
) -> Choice:
    if trust is TrustStatus.TRUSTED and (available.left or available.right):
        return _mono_choice(percept, thresholds)
    return _choice(Cue.NONE, False, math.nan, thresholds.mono_px)


def caution_px(percept: Percept, caution_std: float) -> float:
    """What is added to mono's λ before it is compared with its threshold."""
    return caution_std * percept.mono_std_px if caution_std else 0.0


def _mono_choice(percept: Percept, thresholds: Thresholds) -> Choice:
    cautious_px = percept.mono_px + caution_px(percept, thresholds.caution_std)
    choice = _choice(Cue.MONO, False, cautious_px, thresholds.mono_px)
    strange = percept.mono_novelty > thresholds.novelty
    return choice._replace(blocked=True) if strange else choice


def _choice(cue: Cue, override: bool, disparity_px: float, threshold_px: float) -> Choice:
    blocked = None if math.isnan(disparity_px) else disparity_px > threshold_px
    return Choice(cue, override, disparity_px, threshold_px, blocked)
