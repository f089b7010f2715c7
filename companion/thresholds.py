"""The λ above which each cue reports an obstacle, as the plan and the flight so far say."""

import math

import numpy as np

from companion.flying.switch import Thresholds
from companion.judging.performance import threshold_for_tpr_px
from companion.judging.risk import Approach, Wishes, choose_threshold_px
from companion.judging.scorecard import Scorecard
from companion.kernel.calibration import StereoCalibration
from companion.kernel.messages import Phase
from companion.plan import Plan

PHASES_OF_LEARNING = (Phase.INITIAL, Phase.LEARNING)


def choose_thresholds(
    plan: Plan, approach: Approach, scorecard: Scorecard, rng: np.random.Generator
) -> Thresholds:
    """Mono's comes from the samples of all learning so far, where the plan says so.

    While those hold no positive it is the fixed one.
    """
    behaviour, learner = plan.behaviour, plan.learner
    stereo_px = behaviour.turn_threshold_px
    chosen_px = math.nan
    if learner.threshold == "roc":
        chosen_px = _from_roc_px(scorecard, stereo_px, learner.wanted_tpr)
    elif learner.threshold == "risk":
        wishes = Wishes(
            learner.wanted_collision_probability,
            learner.wanted_spurious_turns_per_m,
            learner.detection_distance_m,
        )
        samples = scorecard.approach_samples(PHASES_OF_LEARNING)
        chosen_px = choose_threshold_px(samples, approach, wishes, rng)
    mono_px = learner.fixed_threshold_px(stereo_px) if math.isnan(chosen_px) else chosen_px
    return Thresholds(
        stereo_px,
        mono_px,
        behaviour.override_threshold_px,
        caution_std=learner.caution_std,
        novelty=math.inf if learner.novelty_limit is None else learner.novelty_limit,
    )


def _from_roc_px(scorecard: Scorecard, positive_px: float, wanted_tpr: float) -> float:
    """NaN while no positive was seen."""
    seen = [scorecard.accounts[phase].estimates() for phase in PHASES_OF_LEARNING]
    stereo_px, mono_px = (np.concatenate(values) for values in zip(*seen, strict=True))
    return threshold_for_tpr_px(mono_px, stereo_px, positive_px, wanted_tpr)


def approach_of(plan: Plan, calibration: StereoCalibration) -> Approach:
    """The approach that the performance model (companion/judging/risk.py) reckons with."""
    return Approach(
        rate_hz=plan.camera.rate_hz,
        speed_m_s=plan.behaviour.forward_speed_m_s,
        disparity_metre_px=calibration.disparity_metre_px,
        positive_threshold_px=plan.behaviour.turn_threshold_px,
    )
