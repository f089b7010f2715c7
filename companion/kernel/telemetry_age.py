"""Whether telemetry tells of the image's moment: both are stamped by clocks of their own."""

import math

MOST_UNUSUAL_NS = 150_000_000
"""Telemetry that is so much older or newer than usual tells of another moment than the image."""
CLOCKS_APART = 1e-4
"""What is usual follows this fast, in s/s: the clocks of camera and autopilot drift apart."""


class TelemetryAge:
    """Whether telemetry comes as long after the images as it usually does."""

    def __init__(self) -> None:
        self._usual_ns = math.nan
        """By how much it is the older one, by the clocks of both."""
        self._stamp_ns = 0

    def is_usual(self, stamp_ns: int, told_ns: int) -> bool:
        """Of the telemetry stamped ``told_ns`` that came with the image of ``stamp_ns``."""
        older_ns = stamp_ns - told_ns
        if math.isnan(self._usual_ns):
            self._usual_ns = older_ns
        most_ns = CLOCKS_APART * max(0, stamp_ns - self._stamp_ns)
        self._usual_ns += min(max(older_ns - self._usual_ns, -most_ns), most_ns)
        self._stamp_ns = stamp_ns
        return abs(older_ns - self._usual_ns) <= MOST_UNUSUAL_NS
