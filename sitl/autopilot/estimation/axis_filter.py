"""One axis of dead reckoning, mended: a Kalman filter of its error and of how fast that grows."""

import math
from typing import Final

_LEAST: Final = 1e-12  # variance that rounding may leave of a large one


class AxisFilter:
    """Estimates what has to be taken away from a dead-reckoned coordinate and from its rate.

    State: (offset, rate), the errors. The rate is a first-order Gauss-Markov process; ``walk`` is
    the square root of its driving intensity, per s^1.5 in units of the offset. Covariance is kept
    as its three different entries.
    """

    def __init__(self, walk: float, rate_time_s: float) -> None:
        self._walk_squared = walk * walk
        self._rate_time_s = rate_time_s
        self.reset(0.0, math.inf)

    def reset(self, offset: float, variance: float) -> None:
        """Believes this from now on; what is known of the rate is forgotten."""
        self.offset, self.rate = offset, 0.0
        self.variance, self._covariance = variance, 0.0
        self.rate_variance = self._walk_squared * self._rate_time_s / 2.0

    def move(self, offset: float, variance: float) -> None:
        """A sudden change of the offset alone."""
        self.offset, self.variance, self._covariance = offset, variance, 0.0

    def predict(self, step_s: float, haste: float = 1.0) -> None:
        """Time passes; ``haste`` multiplies the walk while the rate wanders faster than usual."""
        keep = math.exp(-step_s / self._rate_time_s)
        intensity = self._walk_squared * haste * haste * step_s
        self.offset += self.rate * step_s
        self.rate *= keep
        self.variance += step_s * (2.0 * self._covariance + step_s * self.rate_variance)
        self._covariance = keep * (self._covariance + step_s * self.rate_variance)
        self.rate_variance = keep * keep * self.rate_variance + intensity

    def offset_ratio(self, measured: float, lag_s: float, variance: float, gate: float) -> float:
        """Test ratio of an error measured ``lag_s`` ago: above 1 it is not to be believed."""
        surprise, spread = self._offset_surprise(measured, lag_s, variance)
        return surprise * surprise / (gate * gate * spread)

    def fuse_offset(self, measured: float, lag_s: float, variance: float) -> None:
        surprise, spread = self._offset_surprise(measured, lag_s, variance)
        self._correct(
            surprise / spread,
            self.variance - lag_s * self._covariance,
            self._covariance - lag_s * self.rate_variance,
            spread,
        )

    def rate_ratio(self, measured: float, variance: float, gate: float) -> float:
        surprise = measured - self.rate
        return surprise * surprise / (gate * gate * (self.rate_variance + variance))

    def fuse_rate(self, measured: float, variance: float) -> None:
        spread = self.rate_variance + variance
        surprise = (measured - self.rate) / spread
        self._correct(surprise, self._covariance, self.rate_variance, spread)

    def _offset_surprise(
        self, measured: float, lag_s: float, variance: float
    ) -> tuple[float, float]:
        """(innovation, its variance) of what the offset was ``lag_s`` ago."""
        spread = (
            self.variance
            - 2.0 * lag_s * self._covariance
            + lag_s * lag_s * self.rate_variance
            + variance
        )
        return measured - (self.offset - lag_s * self.rate), spread

    def _correct(self, share: float, to_offset: float, to_rate: float, spread: float) -> None:
        """``to_*``: covariances of the states with what was measured."""
        self.offset += to_offset * share
        self.rate += to_rate * share
        self.variance = max(_LEAST, self.variance - to_offset * to_offset / spread)
        self._covariance -= to_offset * to_rate / spread
        self.rate_variance = max(_LEAST, self.rate_variance - to_rate * to_rate / spread)
