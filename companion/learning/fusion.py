"""Both cues as one estimate of λ: each weighs what its variance says it is worth.

The paper leaves fusion to later work. Stereo's λ is the mean over the pixels that matched: the
fewer matched, the more it depends on which. One eye's λ comes with the spread that its learner
gives it.
"""

import math
from typing import NamedTuple

STEREO_FLOOR_PX = 0.05
STEREO_UNMATCHED_NORM = 0.2
"""Share of λ by which stereo errs where nothing matched; it errs less with the share that did."""


class Estimate(NamedTuple):
    """λ and its standard deviation; NaN while unknown."""

    disparity_px: float
    std_px: float


UNKNOWN = Estimate(math.nan, math.nan)


def stereo_estimate(disparity_px: float, valid_norm: float) -> Estimate:
    """Stereo's λ with the error to expect of it: a floor, and a part that grows with λ and with
    the share of pixels without a match.
    """
    unmatched_px = STEREO_UNMATCHED_NORM * abs(disparity_px) * (1.0 - valid_norm)
    return Estimate(disparity_px, math.hypot(STEREO_FLOOR_PX, unmatched_px))


def fuse(one: Estimate, other: Estimate) -> Estimate:
    """The estimate of least variance, as if their errors were independent.

    Where one λ is unknown it is the other; an estimate of unknown spread has no weight beside one
    that knows its own.
    """
    if math.isnan(one.disparity_px) or math.isnan(other.disparity_px):
        return other if math.isnan(one.disparity_px) else one
    if math.isnan(one.std_px) or math.isnan(other.std_px):
        return other if math.isnan(one.std_px) else one
    total_px2 = one.std_px**2 + other.std_px**2
    if total_px2 == 0.0:
        return Estimate((one.disparity_px + other.disparity_px) / 2.0, 0.0)
    share = other.std_px**2 / total_px2
    disparity_px = share * one.disparity_px + (1.0 - share) * other.disparity_px
    return Estimate(disparity_px, one.std_px * other.std_px / math.sqrt(total_px2))
