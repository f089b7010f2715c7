"""Sticks as a pilot moves them: whether they ask for the control."""

import math
from typing import Final

from sitl.autopilot.interface import ManualInput

_SETTLE_S: Final = 0.5  # a stick that rests for longer than this is not being moved


class StickMotion:
    """Compares each stick with where it was lately."""

    def __init__(self) -> None:
        self._lately: ManualInput | None = None
        self._time_s = math.nan
        self.largest_norm = 0.0
        """Of all sticks: how far it is from where it was; full travel from the centre is 1."""

    def update(self, sticks: ManualInput, time_s: float) -> None:
        if self._lately is None:
            self._lately = sticks
        else:
            keep = math.exp(-max(0.0, time_s - self._time_s) / _SETTLE_S)
            pairs = zip(sticks, self._lately, strict=True)
            self._lately = ManualInput(*(new + keep * (old - new) for new, old in pairs))
        self._time_s = time_s
        pairs = zip(sticks, self._lately, strict=True)
        self.largest_norm = max(abs(new - lately) for new, lately in pairs)
