"""Whether stereo, back from a fault, says what the learned estimate says."""

import math

from companion.kernel.messages import Percept

MEMORY_S = 60.0
USUAL_PX = 1.0
"""Mean difference of the two where none was seen yet."""
ALLOWED_RATIO, ALLOWED_PX = 1.5, 0.5
"""Agreement is a mean difference of no more than this much of the usual one, and this."""


class Agreement:
    """Learns the usual difference while stereo is sound, and compares with it afterwards."""

    def __init__(self, agree_s: float) -> None:
        self.difference_px = math.nan
        """Mean of the last comparison that was made."""
        self._agree_s = agree_s
        self._usual_px = USUAL_PX
        self.restart()

    def restart(self) -> None:
        """The comparison begins anew."""
        self._known_s = self._difference_px_s = 0.0

    def learn(self, percept: Percept, period_s: float) -> None:
        difference_px = abs(percept.stereo_px - percept.mono_px)
        if not math.isnan(difference_px):
            share = min(1.0, period_s / MEMORY_S)
            self._usual_px += share * (difference_px - self._usual_px)

    def reached(self, percept: Percept, period_s: float) -> bool:
        """True once the two have agreed over the time wanted; only frames with both count."""
        difference_px = abs(percept.stereo_px - percept.mono_px)
        if math.isnan(difference_px):
            return False
        self._known_s += period_s
        self._difference_px_s += difference_px * period_s
        if self._known_s < self._agree_s:
            return False
        self.difference_px = self._difference_px_s / self._known_s
        self.restart()
        return self.difference_px <= ALLOWED_RATIO * self._usual_px + ALLOWED_PX
