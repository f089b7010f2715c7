"""The paper's finite state machine (section III-D): from "blocked ahead?" to where to fly.

It sees no disparity: the switch has compared λ with the threshold of the cue that flies.
"""

import math
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta

from companion.flying.tether import ZoneSettings
from companion.kernel.frames import wrap_angle_rad
from companion.kernel.messages import BehaviourState, Goal
from companion.kernel.settings import Settings

Positive = Annotated[float, Meta(gt=0)]

ASTRAY_RAD = math.radians(20.0)
"""Further than this off the way back into its zone it turns."""
DETOUR_NS = 3_000_000_000
"""It flies so long around what blocks the way back before it tries again."""
LEEWAY_NS = 2_000_000_000
"""After a search in vain it has left the place when it has flown straight for so long."""


class BehaviourSettings(Settings, frozen=True):
    """``[behaviour]``: thresholds on λ and the way the vehicle moves."""

    turn_threshold_px: Positive = 4.0
    """Stereo turns when λ exceeds it; also what makes a frame a positive in the ROC."""
    override_threshold_px: Positive = 5.0
    """Stereo takes the control from mono when its λ exceeds it."""
    forward_speed_m_s: Annotated[float, Meta(ge=0, le=3)] = 0.5
    """0 hovers where it took off."""
    speed_by_certainty: bool = False
    """On one eye it flies the slower the less certain it is that the way is clear."""
    speed_floor_m_s: Annotated[float, Meta(ge=0, le=3)] = 0.15
    """Its speed while it is not certain at all, and yet sees no obstacle."""
    yaw_rate_deg_s: Annotated[float, Meta(gt=0, le=180)] = 45.0
    heading_tolerance_deg: Annotated[float, Meta(gt=0, le=45)] = 5.0
    turn_to: Literal["random", "freer"] = "random"
    """The side that it turns to; how far is drawn at random in any case."""
    unknown_limit_s: Positive = 1.0
    """λ unknown for longer while flying ahead counts as blocked: turn away."""
    height_m: Annotated[float, Meta(gt=0.2, le=10)] = 1.2
    zone: tuple[ZoneSettings, ...] = ()
    """Where to explore, and when; none leaves it to the walls."""


class Behaviour:
    """Straight; when blocked stop and turn to a random heading; search on if still blocked.

    Out of its zone it turns towards the way back, and what blocks that is passed at random.
    """

    def __init__(self, settings: BehaviourSettings, rng: np.random.Generator) -> None:
        self.settings = settings
        self.state = BehaviourState.STRAIGHT
        self._rng = rng
        self._heading_rad = math.nan
        self._turn_sign = 0
        self._unknown_since_ns: int | None = None
        self._turned_ns: int | None = None
        self._searched_rad = 0.0
        self._yaw_rad = math.nan
        self._turning_ns = 0
        """The last frame that it turned in."""

    @property
    def searched_in_vain(self) -> bool:
        """It turned full circle and saw no clear way, and has not left the place since.

        Whoever added a margin to λ may give it up: turning on for ever is no safer.
        """
        return self._searched_rad >= math.tau

    @property
    def looks_ahead(self) -> bool:
        """Whether the next step depends on the obstacle ahead (a rotation ignores it)."""
        return self.state is not BehaviourState.ROTATE

    def step(
        self,
        stamp_ns: int,
        blocked: bool | None,
        yaw_rad: float,
        freer_sign: int = 0,
        way_back_rad: float | None = None,
    ) -> Goal:
        """One frame on. ``blocked`` is None while λ is unknown, ``way_back_rad`` in the zone.

        ``freer_sign``: +1 where the way is freer on the right, -1 on the left, 0 unknown.
        """
        self._note_search(stamp_ns, yaw_rad)
        if math.isnan(self._heading_rad) and self.state is BehaviourState.STRAIGHT:
            self._heading_rad = yaw_rad
        if self.state is BehaviourState.STRAIGHT:
            if self._must_turn(stamp_ns, blocked):
                turn_rad = self._random_turn_rad(yaw_rad, way_back_rad, freer_sign)
                self._begin_turn(stamp_ns, yaw_rad, turn_rad)
            elif way_back_rad is not None and self._strays(stamp_ns, way_back_rad):
                self._begin_turn(stamp_ns, yaw_rad, wrap_angle_rad(way_back_rad - yaw_rad))
        elif self.state is BehaviourState.SEARCH or self._aligned(yaw_rad):
            self._go_on(blocked, yaw_rad)
        return self._goal(blocked)

    def _note_search(self, stamp_ns: int, yaw_rad: float) -> None:
        """How far it has turned since it last flew straight on."""
        if self.state is not BehaviourState.STRAIGHT:
            self._turning_ns = stamp_ns
        elif not self.searched_in_vain or stamp_ns - self._turning_ns >= LEEWAY_NS:
            self._searched_rad = 0.0
        if self.state is BehaviourState.SEARCH:
            self._searched_rad += abs(wrap_angle_rad(yaw_rad - self._yaw_rad))
        self._yaw_rad = yaw_rad

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

    def _strays(self, stamp_ns: int, way_back_rad: float) -> bool:
        off_rad = abs(wrap_angle_rad(way_back_rad - self._heading_rad))
        detour = self._turned_ns is not None and stamp_ns - self._turned_ns < DETOUR_NS
        return off_rad > ASTRAY_RAD and not detour

    def _random_turn_rad(
        self, yaw_rad: float, way_back_rad: float | None, freer_sign: int
    ) -> float:
        """Anywhere; out of the zone anywhere that does not lead further away."""
        if way_back_rad is not None:
            heading_rad = way_back_rad + self._rng.uniform(-math.pi / 2, math.pi / 2)
            return wrap_angle_rad(heading_rad - yaw_rad)
        turn_rad = self._rng.uniform(-math.pi, math.pi)
        if self.settings.turn_to == "freer" and freer_sign:
            turn_rad = math.copysign(turn_rad, freer_sign)
        return turn_rad

    def _begin_turn(self, stamp_ns: int, yaw_rad: float, turn_rad: float) -> None:
        self._heading_rad = wrap_angle_rad(yaw_rad + turn_rad)
        self._turn_sign = 1 if turn_rad >= 0 else -1
        self._turned_ns = stamp_ns
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
