"""What the stated spread of an estimate is worth, from frames on which its error was seen.

Neighbours that agree may all be wrong: a learner's own spread can be several times too small. The
errors before learning say by how much.
"""

import math

FLOOR_PX = 0.1
"""Added to a stated spread: neighbours that agree to the last digit are not certain."""
MEMORY_FRAMES = 600
"""Errors that the factor is about the mean of."""


class SpreadScale:
    """Root mean square of errors in units of the stated spread; 1 until one was seen."""

    def __init__(self) -> None:
        self._mean_square = 1.0
        self._n_seen = 0

    @property
    def factor(self) -> float:
        return math.sqrt(self._mean_square)

    def of(self, stated_std_px: float) -> float:
        """The spread to reckon with."""
        return self.factor * math.hypot(stated_std_px, FLOOR_PX)

    def learn(self, error_px: float, stated_std_px: float) -> None:
        """Counts a frame in; what is unknown does not count."""
        if math.isnan(error_px) or math.isnan(stated_std_px):
            return
        square = error_px**2 / (stated_std_px**2 + FLOOR_PX**2)
        self._n_seen = min(self._n_seen + 1, MEMORY_FRAMES)
        self._mean_square += (square - self._mean_square) / self._n_seen
