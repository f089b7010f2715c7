"""Mission mode: what the vehicle does for each item of a mission."""

import math
from collections.abc import Callable
from typing import NamedTuple

from companion.kernel.frames import Vector3, wrap_angle_rad
from companion.kernel.messages import NAN
from sitl.autopilot.control import Goal
from sitl.autopilot.ground import GroundDetector
from sitl.autopilot.interface import NAN3, Estimate
from sitl.autopilot.mission import (
    ChangeSpeed,
    Delay,
    LandAt,
    Mission,
    ReturnToLaunch,
    TakeOffTo,
    TurnTo,
    Waypoint,
)
from sitl.autopilot.modes import GoTo, Land, Mode, TakeOff
from sitl.autopilot.parameters import Number

Condition = Callable[[Estimate], bool]


class _Stage(NamedTuple):
    """What to fly, and until when."""

    leg: Mode
    done: Condition


class _Then:
    """True ``duration_s`` after ``begun`` was first true."""

    def __init__(self, begun: Condition, duration_s: float) -> None:
        self._begun = begun
        self._duration_s = duration_s
        self._since_s = math.nan

    def __call__(self, estimate: Estimate) -> bool:
        if math.isnan(self._since_s) and self._begun(estimate):
            self._since_s = estimate.time_s
        return estimate.time_s - self._since_s >= self._duration_s


class FlyMission(Mode):
    """Flies ``mission`` from its current item on; an item that changes meanwhile is begun anew."""

    def __init__(
        self, mission: Mission, ground: GroundDetector, parameters: dict[str, Number]
    ) -> None:
        self.mission = mission
        self._ground = ground
        self._parameters = parameters
        self._visit = -1
        self._stages: list[_Stage] = []
        self._stay = GoTo(NAN3, self._speed_m_s)

    @property
    def leg(self) -> Mode:
        return self._stages[0].leg if self._stages else self._stay

    @property
    def over(self) -> bool:
        return self.mission.complete or not self.mission.items

    @property
    def calls_for_return(self) -> bool:
        """Whether the last item flown was a return to launch."""
        mission = self.mission
        return mission.complete and isinstance(mission.item, ReturnToLaunch)

    def stand(self, estimate: Estimate) -> None:
        self._advance(estimate)

    def goal(self, estimate: Estimate) -> Goal:
        self._advance(estimate)
        return self.leg.goal(estimate)

    def _advance(self, estimate: Estimate) -> None:
        """Follows what has happened since the last step; at most one item is finished."""
        if self.over:
            return
        if self._visit != self.mission.visits:
            self._visit, self.mission.begun = self.mission.visits, True
            self._stages = self._begin(estimate)
        if self._stages and self._stages[0].done(estimate):
            self._keep_place(self._stages.pop(0).leg)
        if not self._stages:
            self.mission.finish_item()

    def _keep_place(self, leg: Mode) -> None:
        """What follows without a place of its own stays at this leg's."""
        if isinstance(leg, GoTo):
            self._stay = leg

    def _begin(self, estimate: Estimate) -> list[_Stage]:
        """The stages of the current item; none if it is done at once."""
        item, standing = self.mission.item, self._ground.standing
        if isinstance(item, Waypoint):
            return [*self._climb(item.position_ned_m, estimate), self._travel(item)]
        if isinstance(item, TakeOffTo):
            return self._take_off(item, estimate)
        if isinstance(item, LandAt):
            return [] if standing else self._land(item, estimate)
        if isinstance(item, Delay):
            return [_Stage(self._stay, _Then(lambda _: True, item.duration_s))]
        if isinstance(item, TurnTo):
            return [] if standing else self._turn(item, estimate)
        if isinstance(item, ChangeSpeed):
            self.mission.speed_m_s = item.speed_m_s
        return []

    def _climb(self, position_ned_m: Vector3, estimate: Estimate) -> list[_Stage]:
        """Off the ground first, when it stands there."""
        if not self._ground.standing:
            return []
        climb = TakeOff(estimate, -position_ned_m[2], self._parameters)
        return [_Stage(climb, lambda _: climb.done)]

    def _travel(self, item: Waypoint) -> _Stage:
        leg = GoTo(item.position_ned_m, self._speed_m_s, item.yaw_rad)
        radius_m = item.acceptance_m
        if math.isnan(radius_m):
            radius_m = self._parameters["NAV_ACC_RAD"]
        return _Stage(leg, _Then(self._arrival(leg, item.yaw_rad, radius_m), item.hold_s))

    def _arrival(self, leg: GoTo, yaw_rad: float, radius_m: float) -> Condition:
        def arrived(estimate: Estimate) -> bool:
            return (
                leg.level_distance_m(estimate) < radius_m
                and leg.height_error_m(estimate) < self._parameters["NAV_MC_ALT_RAD"]
                and self._heads_to(yaw_rad, estimate)
            )

        return arrived

    def _take_off(self, item: TakeOffTo, estimate: Estimate) -> list[_Stage]:
        north_m, east_m, down_m = item.position_ned_m
        here = estimate.position_ned_m
        place = (here[0], here[1], down_m) if math.isnan(north_m) else (north_m, east_m, down_m)
        return [*self._climb(place, estimate), self._travel(Waypoint(place, yaw_rad=item.yaw_rad))]

    def _land(self, item: LandAt, estimate: Estimate) -> list[_Stage]:
        north_m, east_m, _ = item.position_ned_m
        land = _Stage(
            Land(self._parameters, (north_m, east_m, NAN)), lambda _: self._ground.standing
        )
        if math.isnan(north_m):
            return [land]
        above = (north_m, east_m, estimate.position_ned_m[2])
        return [self._travel(Waypoint(above, yaw_rad=item.yaw_rad)), land]

    def _turn(self, item: TurnTo, estimate: Estimate) -> list[_Stage]:
        yaw_rad = item.yaw_rad + (estimate.yaw_rad if item.relative else 0.0)
        yaw_rad = wrap_angle_rad(yaw_rad)
        leg = GoTo(self._stay.position_ned_m, self._speed_m_s, yaw_rad)
        return [_Stage(leg, lambda now: self._heads_to(yaw_rad, now))]

    def _heads_to(self, yaw_rad: float, estimate: Estimate) -> bool:
        if math.isnan(yaw_rad):
            return True
        error_rad = abs(wrap_angle_rad(yaw_rad - estimate.yaw_rad))
        return error_rad < math.radians(self._parameters["MIS_YAW_ERR"])

    def _speed_m_s(self) -> float:
        asked_m_s = self.mission.speed_m_s
        return self._parameters["MPC_XY_CRUISE"] if math.isnan(asked_m_s) else asked_m_s
