"""How sure the cue that flies is that the way is clear, and what speed that allows."""

import math

from companion.flying.behaviour import BehaviourSettings
from companion.flying.switch import Choice
from companion.kernel.messages import Cue, Goal, Percept

SURE_STD = 2.0
"""Standard deviations between λ and its threshold that make a clear way certain."""
FAMILIAR_NOVELTY, STRANGE_NOVELTY = 1.0, 2.0
"""Up to the first, novelty costs no certainty; from the second on none is left."""


def certainty_norm(choice: Choice, percept: Percept) -> float:
    """From 0 (nothing is known, or λ is at its threshold) to 1; stereo is taken for certain.

    An estimate of unknown spread is not certain at all; one of unknown novelty is taken as told.
    """
    if choice.cue is Cue.STEREO:
        return 1.0
    fused = choice.cue is Cue.FUSED
    std_px = percept.fused_std_px if fused else percept.mono_std_px
    if choice.cue is Cue.NONE or math.isnan(std_px):
        return 0.0
    clear = _share(choice.threshold_px - choice.disparity_px, 0.0, SURE_STD * std_px)
    if fused:
        return clear
    return clear * (1.0 - _share(percept.mono_novelty, FAMILIAR_NOVELTY, STRANGE_NOVELTY))


def with_speed_for(goal: Goal, certainty: float, settings: BehaviourSettings) -> Goal:
    """``goal`` no faster than this certainty allows: from the floor to the plan's speed."""
    fastest_m_s, floor_m_s = settings.forward_speed_m_s, settings.speed_floor_m_s
    allowed_m_s = floor_m_s + certainty * (fastest_m_s - floor_m_s)
    return Goal(
        forward_speed_m_s=min(goal.forward_speed_m_s, allowed_m_s),
        heading_rad=goal.heading_rad,
        turn_sign=goal.turn_sign,
    )


def _share(value: float, low: float, high: float) -> float:
    """Where ``value`` lies between the two, clipped to 0..1; NaN lies at the lower end."""
    if not value > low:
        return 0.0
    return min(1.0, (value - low) / (high - low)) if high > low else 1.0
