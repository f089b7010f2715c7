"""The paper's finite state machine (section III-D): from "blocked ahead?" to where to fly.

It sees no disparity: the switch has compared λ with the threshold of the cue that flies.
"""

import math
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta

from companion.kernel.frames import wrap_angle_rad
from companion.kernel.messages import BehaviourState, Goal
from companion.kernel.settings import Settings

Positive = Annotated[float, Meta(gt=0)]


class BehaviourSettings(Settings, frozen=True):
    """``[behaviour]``: thresholds on λ and the way the vehicle moves."""

    turn_threshold_px: Positive = 4.0
    """Stereo turns when λ exceeds it; also what makes a frame a positive in the ROC."""
    override_threshold_px: Positive = 5.0
    """Stereo takes the control from mono when its λ exceeds it."""
    forward_speed_m_s: Annotated[float, Meta(ge=0, le=3)] = 0.5
    """0 hovers where it took off."""
    yaw_rate_deg_s: Annotated[float, Meta(gt=0, le=180)] = 45.0
    heading_tolerance_deg: Annotated[float, Meta(gt=0, le=45)] = 5.0
    turn_to: Literal["random", "freer"] = "random"
    """The side that it turns to; how far is drawn at random in any case."""
    unknown_limit_s: Positive = 1.0
    """λ unknown for longer while flying ahead counts as blocked: turn away."""
    height_m: Annotated[float, Meta(gt=0.2, le=10)] = 1.2


class Behaviour:
    """Straight; when blocked stop and turn to a random heading; search on if still blocked."""

    def __init__(self, settings: BehaviourSettings, rng: np.random.Generator) -> None:
        self.settings = settings
        self.state = BehaviourState.STRAIGHT
        self._rng = rng
        self._heading_rad = math.nan
        self._turn_sign = 0
        self._unknown_since_ns: int | None = None

    @property
    def looks_ahead(self) -> bool:
        """Whether the next step depends on the obstacle ahead (a rotation ignores it)."""
        return self.state is not BehaviourState.ROTATE

    def step(
        self, stamp_ns: int, blocked: bool | None, yaw_rad: float, freer_sign: int = 0
    ) -> Goal:
        """One frame on. ``blocked`` is None while λ is unknown.

        ``freer_sign``: +1 where the way is freer on the right, -1 on the left, 0 unknown.
        """
        if math.isnan(self._heading_rad) and self.state is BehaviourState.STRAIGHT:
            self._heading_rad = yaw_rad
        if self.state is BehaviourState.STRAIGHT:
            if self._must_turn(stamp_ns, blocked):
                self._begin_turn(yaw_rad, freer_sign)
        elif self.state is BehaviourState.SEARCH or self._aligned(yaw_rad):
            self._go_on(blocked, yaw_rad)
        return self._goal(blocked)

    def _must_turn(self, stamp_ns: int, blocked: bool | None) -> bool:
        if blocked is not None:
            self._unknown_since_ns = None
            return blocked
        if self._unknown_since_ns is None:
            self._unknown_since_ns = stamp_ns
        return (stamp_ns - self._unknown_since_ns) * 1e-9 > self.settings.unknown_limit_s

    def _aligned(self, yaw_rad: float) -> bool:
        error_rad = wrap_angle_rad(self._heading_rad - yaw_rad)
        return abs(error_rad) <= math.radians(self.settings.heading_tolerance_deg)

    def _begin_turn(self, yaw_rad: float, freer_sign: int) -> None:
        turn_rad = self._rng.uniform(-math.pi, math.pi)
        if self.settings.turn_to == "freer" and freer_sign:
            turn_rad = math.copysign(turn_rad, freer_sign)
        self._heading_rad = wrap_angle_rad(yaw_rad + turn_rad)
        self._turn_sign = 1 if turn_rad >= 0 else -1
        self._unknown_since_ns = None
        self.state = BehaviourState.ROTATE

    def _go_on(self, blocked: bool | None, yaw_rad: float) -> None:
        """Straight on where it is clear; else the turn goes on the same way."""
        if blocked is False:
            self.state = BehaviourState.STRAIGHT
            self._heading_rad = yaw_rad
        else:
            self.state = BehaviourState.SEARCH

    def _goal(self, blocked: bool | None) -> Goal:
        if self.state is BehaviourState.STRAIGHT:
            speed_m_s = self.settings.forward_speed_m_s if blocked is False else 0.0
            return Goal(forward_speed_m_s=speed_m_s, heading_rad=self._heading_rad, turn_sign=0)
        heading_rad = self._heading_rad if self.state is BehaviourState.ROTATE else math.nan
        return Goal(forward_speed_m_s=0.0, heading_rad=heading_rad, turn_sign=self._turn_sign)
