"""λ from the vehicle's own motion: what nearness is worth in pixels, learned from stereo.

Parallax (companion.vision.parallax) gives the mean inverse depth of what one eye sees; λ is a mean
over the pixels that stereo can match. The ratio of the two is focal length times baseline, and
holds whatever the estimate of speed and the choice of pixels are wrong by: it is learned, not
computed.
"""

import math
from collections import deque

import numpy as np

from companion.kernel.parts import Arrays
from companion.learning.fusion import UNKNOWN, Estimate, fuse

LEAST_SAMPLES, MOST_SAMPLES = 50, 2000
"""Before, there is no answer; beyond, the oldest are forgotten."""
RENEWED_EVERY = 10
LEAST_PER_M, LEAST_PX = 0.05, 0.5
"""What is further away says nothing of the ratio."""
FLOOR_PX = 0.05
"""Of the spread, where λ is small."""
SHARE, DEVIATIONS = 0.8, 1.2816
"""Of a normal variable so large a share lies within as many deviations."""
CONTRADICTION_STD = 3.0


class MotionScale:
    """λ over nearness: the median of the last samples, and how far they scatter."""

    def __init__(self) -> None:
        self._log_ratios: deque[float] = deque(maxlen=MOST_SAMPLES)
        self._n_new = 0
        self._ratio_px_m, self._spread_norm = math.nan, math.nan

    def estimate(self, nearness_per_m: float) -> Estimate:
        """λ; unknown without motion, or before enough was learned."""
        if math.isnan(nearness_per_m) or math.isnan(self._ratio_px_m):
            return UNKNOWN
        disparity_px = self._ratio_px_m * nearness_per_m
        return Estimate(disparity_px, math.hypot(FLOOR_PX, self._spread_norm * disparity_px))

    def learn(self, nearness_per_m: float, disparity_px: float) -> None:
        """Takes stereo's λ as the truth."""
        if not (nearness_per_m > LEAST_PER_M and disparity_px > LEAST_PX):
            return
        self._log_ratios.append(math.log(disparity_px / nearness_per_m))
        self._n_new += 1
        if self._n_new >= RENEWED_EVERY:
            self._renew()

    def state(self) -> Arrays:
        """The logarithms of the samples' ratios."""
        return {"log_ratios": np.array(self._log_ratios, dtype=np.float64)}

    def restore(self, state: Arrays) -> None:
        """Takes up where ``state`` was taken; a model learned without motion has none."""
        self._log_ratios.clear()
        self._log_ratios.extend(state["log_ratios"].tolist() if state else ())
        self._ratio_px_m, self._spread_norm = math.nan, math.nan
        self._renew()

    def _renew(self) -> None:
        self._n_new = 0
        if len(self._log_ratios) < LEAST_SAMPLES:
            return
        logs = np.array(self._log_ratios)
        middle = float(np.median(logs))
        self._ratio_px_m = math.exp(middle)
        self._spread_norm = float(np.quantile(np.abs(logs - middle), SHARE)) / DEVIATIONS


def reconcile(appearance: Estimate, motion: Estimate) -> Estimate:
    """Both weighed by their variances; the nearer one alone where they contradict each other.

    A wall that one of the two does not see must not be averaged away.
    """
    apart_px = abs(appearance.disparity_px - motion.disparity_px)
    if apart_px > CONTRADICTION_STD * math.hypot(appearance.std_px, motion.std_px):
        return max(appearance, motion)
    return fuse(appearance, motion)
