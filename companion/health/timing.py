"""When frames were taken and when they came: late ones, and stamps that cannot be."""

import math

from companion.health.eyes import Sign
from companion.kernel.messages import CameraFault, StereoFrame

LATE_S = 0.2
"""Behind the promptest frame so far."""
CLOCKS_APART = 1e-4
"""The promptest frame's delay is forgotten this fast, in s/s: clocks drift against each other."""
SKEW_S = 0.005
"""Turning at 45 degrees per second the picture moves by half a pixel meanwhile."""
LONGEST_PERIOD_S = 1.0
"""What a gap counts for, at most."""


class FrameClock:
    """The camera's time, as its stamps tell it."""

    def __init__(self) -> None:
        self.stamp_ns = 0
        self.period_s = 0.0
        """From the last frame to this one."""
        self.late_s = 0.0
        """How much longer than the promptest one this frame took, by the clock that says least; 0
        where nobody knows."""
        self._started = False
        self._promptest_s: dict[int, float] = {}
        """By clock."""

    def tick(self, frame: StereoFrame, *arrived_s: float) -> Sign | None:
        """One frame on. ``arrived_s``: when it came, by one clock or several that do not depend on
        each other; NaN where one does not know.
        """
        step_s = (frame.stamp_ns - self.stamp_ns) * 1e-9 if self._started else math.nan
        self._started, self.stamp_ns = True, frame.stamp_ns
        # A stamp that stands still is a fault that must count for something.
        self.period_s = min(step_s, LONGEST_PERIOD_S) if step_s > 0.0 else self.period_s
        stamp_s = frame.stamp_ns * 1e-9
        late_s = [self._late_s(number, now_s - stamp_s) for number, now_s in enumerate(arrived_s)]
        self.late_s = min(late_s, default=0.0)
        if step_s <= 0.0:
            text = f"stamp {-step_s:.3f} s behind the last one"
            return Sign(CameraFault.DESYNCHRONISED, text)
        if abs(frame.skew_ns) * 1e-9 > SKEW_S:
            text = f"right eye {frame.skew_ns * 1e-6:+.0f} ms from the left"
            return Sign(CameraFault.DESYNCHRONISED, text)
        if self.late_s > LATE_S:
            return Sign(CameraFault.LATE, f"{self.late_s:.2f} s late")
        return None

    def _late_s(self, clock: int, delay_s: float) -> float:
        if math.isnan(delay_s):
            return 0.0
        before_s = self._promptest_s.get(clock, math.inf) + CLOCKS_APART * self.period_s
        self._promptest_s[clock] = min(before_s, delay_s)
        return delay_s - self._promptest_s[clock]
