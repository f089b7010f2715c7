"""From signs to verdicts: a fault counts once it has lasted, and is over once it stays away."""

import math
from typing import Annotated

from msgspec import Meta

from companion.health.eyes import Sign
from companion.kernel.messages import CameraFault
from companion.kernel.settings import Settings

Seconds = Annotated[float, Meta(gt=0, le=60)]
ROUNDING_S = 1e-6


class HealthSettings(Settings, frozen=True):
    """``[health]``: how long a fault of the cameras must last, and must have been over."""

    confirm_s: Annotated[float, Meta(gt=0, le=0.3)] = 0.2
    """A fault that is seen for this long counts: with the frame on which it is seen first, and the
    one on which this time is over, well within half a second at 10 frames per second."""
    clear_s: Seconds = 1.5
    """Not seen for this long, it is over."""
    agree_s: Seconds = 3.0
    """Stereo must agree with the learned estimate for this long before it is trusted again."""


class Debounce:
    """The fault of one eye or pair, if there is one. Time is the frames' own."""

    def __init__(self, settings: HealthSettings) -> None:
        self.fault: CameraFault | None = None
        self.evidence = ""
        """Of the newest sign."""
        self._settings = settings
        self._seen_s: dict[CameraFault, float] = {}
        self._clean_s = math.inf

    def update(self, sign: Sign | None, period_s: float) -> None:
        """One frame on, ``period_s`` after the last one.

        Another fault that is seen for as long takes the first one's place: it may explain it.
        """
        self._forget(sign, period_s)
        if sign is None:
            self._clean_s += period_s
            if self._clean_s > self._settings.clear_s - ROUNDING_S:
                self.fault = None
            return
        self._clean_s = 0.0
        self.evidence = sign.evidence
        seen_s = self._seen_s[sign.fault] = self._seen_s.get(sign.fault, 0.0) + period_s
        if seen_s > self._settings.confirm_s - ROUNDING_S:
            self.fault = sign.fault

    def _forget(self, sign: Sign | None, period_s: float) -> None:
        """What comes and goes with every other frame is still a fault, sooner or later."""
        kept = {
            fault: min(seen_s, self._settings.confirm_s) - period_s / 2
            for fault, seen_s in self._seen_s.items()
            if sign is None or fault is not sign.fault
        }
        now = {} if sign is None else {sign.fault: self._seen_s.get(sign.fault, 0.0)}
        self._seen_s = {fault: seen_s for fault, seen_s in kept.items() if seen_s > 0.0} | now
