"""Position, velocity and heading control: a goal and an estimate in, an attitude out.

The cascade is PX4's: position error -> velocity -> acceleration -> tilt and thrust. What differs is
that every change of velocity passes a jerk-limited reference, in offboard mode too, so that the
camera does not nod wildly.
"""

import math
from typing import Final, NamedTuple

from companion.kernel.frames import Vector3, wrap_angle_rad
from companion.kernel.messages import NAN
from sitl.airframe import GRAVITY_M_S2
from sitl.autopilot.interface import NAN3, Estimate
from sitl.autopilot.parameters import Number
from sitl.autopilot.smoothing import SmoothSpeed, SmoothVelocity2

_DRAG_1_S: Final = 0.54  # 0.25 N s/m over 0.46 kg (aerodynamics.xml): known, so fed forward
_TILT_LAG_S: Final = 0.15  # from a wanted acceleration to the tilt that gives it (airframe's loops)
_JERK_VERTICAL_M_S3: Final = 15.0
_YAW_JERK_RAD_S3: Final = 40.0
_LEVEL_INTEGRAL_LIMIT_M_S2: Final = 4.0  # 7 m/s of wind; a wall it leans on winds up no more
_DOWN_INTEGRAL_LIMIT_M_S2: Final = 4.0  # of a battery or rotor that gives less than expected
_FAR_M: Final = 1.0
_BRAKING_SHARE: Final = 0.7  # of MPC_ACC_HOR: so fast that it still stops in time at a place
_HEADING_LATCH_RAD_S: Final = 0.02  # a turn is over when its reference is slower than this


class Goal(NamedTuple):
    """What a mode wants at this moment.

    Position axes of NaN are steered by velocity; with a position, the velocity is added to what the
    position asks for. A yaw rate of NaN steers to ``yaw_rad``, or keeps the heading if that is NaN.
    The acceleration is added to the loops' own; with a velocity of NaN it is all there is, on both
    level axes if on one.
    """

    position_ned_m: Vector3 = NAN3
    velocity_ned_m_s: Vector3 = (0.0, 0.0, 0.0)
    yaw_rad: float = NAN
    yaw_rate_rad_s: float = NAN
    climb_limit_m_s: float = math.inf
    level_limit_m_s: float = math.inf
    acceleration_ned_m_s2: Vector3 = (0.0, 0.0, 0.0)


class AttitudeCommand(NamedTuple):
    """What the airframe's inner loops fly."""

    roll_rad: float
    pitch_rad: float
    yaw_rate_rad_s: float
    thrust_norm: float
    roll_rate_rad_s: float = NAN
    """With ``pitch_rate_rad_s`` flown instead of the angles, unless NaN."""
    pitch_rate_rad_s: float = NAN


class MotorCommand(NamedTuple):
    """For the airframe: whether the rotors are powered, and what its inner loops fly."""

    spinning: bool
    attitude: AttitudeCommand


RELAXED: Final = AttitudeCommand(0.0, 0.0, 0.0, 0.0)


class Controller:
    """One cascade; ``update`` is to be called at a steady rate while flying."""

    def __init__(
        self, parameters: dict[str, Number], hover_thrust_norm: float, update_hz: int
    ) -> None:
        self._parameters = parameters
        self._thrust_per_m_s2 = hover_thrust_norm / GRAVITY_M_S2
        self._step_s = step_s = 1.0 / update_hz
        self._level = SmoothVelocity2(step_s, _TILT_LAG_S)
        self._down = SmoothSpeed(step_s)
        self._turn = SmoothSpeed(step_s)
        self._integral_north = self._integral_east = self._integral_down = 0.0
        self.yaw_setpoint_rad = NAN
        self.velocity_setpoint_ned_m_s = NAN3

    def reset(self, estimate: Estimate) -> None:
        """Forgets what was learned on the last flight and starts from the motion of now."""
        v_north, v_east, v_down = estimate.velocity_ned_m_s
        self._level.reset(v_north, v_east)
        self._down.reset(v_down)
        self._turn.reset(0.0)
        self._integral_north = self._integral_east = self._integral_down = 0.0
        self.yaw_setpoint_rad = estimate.yaw_rad

    @property
    def descent_setpoint_m_s(self) -> float:
        """Where the vertical reference has got to."""
        return self._down.speed

    def update(self, goal: Goal, estimate: Estimate) -> AttitudeCommand:
        """One step of the cascade."""
        north, east = self._level_acceleration(goal, estimate)
        down = self._down_acceleration(goal, estimate)
        self.velocity_setpoint_ned_m_s = (
            self._level.north_m_s,
            self._level.east_m_s,
            self._down.speed,
        )
        yaw_rate_rad_s = self._yaw_rate(goal, estimate)
        return self._attitude(north, east, down, estimate.yaw_rad, yaw_rate_rad_s)

    def _level_acceleration(self, goal: Goal, estimate: Estimate) -> tuple[float, float]:
        """(north, east) acceleration that follows the goal, drag compensated."""
        parameters, level = self._parameters, self._level
        push_north, push_east, _ = goal.acceleration_ned_m_s2
        v_north, v_east = self._level_velocity(goal, estimate)
        if v_north != v_north or v_east != v_east:  # NaN: steered by acceleration
            level.reset(*estimate.velocity_ned_m_s[:2])
            return push_north + self._integral_north, push_east + self._integral_east
        level.step(v_north, v_east, parameters["MPC_ACC_HOR"], parameters["MPC_JERK_AUTO"])
        error_north = level.expected_north_m_s - estimate.velocity_ned_m_s[0]
        error_east = level.expected_east_m_s - estimate.velocity_ned_m_s[1]
        rate = parameters["MPC_XY_VEL_I_ACC"] * self._step_s
        limit = _LEVEL_INTEGRAL_LIMIT_M_S2
        self._integral_north = _bounded(self._integral_north + rate * error_north, limit)
        self._integral_east = _bounded(self._integral_east + rate * error_east, limit)
        gain = parameters["MPC_XY_VEL_P_ACC"]
        return (
            push_north
            + level.north_m_s2
            + _DRAG_1_S * level.north_m_s
            + gain * error_north
            + self._integral_north,
            push_east
            + level.east_m_s2
            + _DRAG_1_S * level.east_m_s
            + gain * error_east
            + self._integral_east,
        )

    def _level_velocity(self, goal: Goal, estimate: Estimate) -> tuple[float, float]:
        """Velocity wanted after the position loop, no faster than allowed."""
        v_north, v_east, _ = goal.velocity_ned_m_s
        north, east, _ = goal.position_ned_m
        gain = self._parameters["MPC_XY_P"]
        distance_m = math.dist((north, east), estimate.position_ned_m[:2])
        if distance_m > _FAR_M:  # not NaN: far away, no faster than it can brake
            braking_m_s2 = _BRAKING_SHARE * self._parameters["MPC_ACC_HOR"]
            gain = min(gain, math.sqrt(2.0 * braking_m_s2 / distance_m))
        if north == north:
            v_north += gain * (north - estimate.position_ned_m[0])
        if east == east:
            v_east += gain * (east - estimate.position_ned_m[1])
        limit = min(self._parameters["MPC_XY_VEL_MAX"], goal.level_limit_m_s)
        speed = math.hypot(v_north, v_east)
        if speed > limit:
            v_north, v_east = v_north * limit / speed, v_east * limit / speed
        return v_north, v_east

    def _down_acceleration(self, goal: Goal, estimate: Estimate) -> float:
        parameters = self._parameters
        v_down = goal.velocity_ned_m_s[2]
        if goal.position_ned_m[2] == goal.position_ned_m[2]:
            v_down += parameters["MPC_Z_P"] * (goal.position_ned_m[2] - estimate.position_ned_m[2])
        if v_down != v_down:  # NaN: steered by acceleration
            self._down.reset(estimate.velocity_ned_m_s[2])
            return goal.acceleration_ned_m_s2[2] + self._integral_down
        fastest_up = min(parameters["MPC_Z_VEL_MAX_UP"], goal.climb_limit_m_s)
        v_down = max(-fastest_up, min(parameters["MPC_Z_VEL_MAX_DN"], v_down))
        down = self._down
        down.step(
            v_down,
            parameters["MPC_ACC_DOWN_MAX"],
            parameters["MPC_ACC_UP_MAX"],
            _JERK_VERTICAL_M_S3,
        )
        error = down.speed - estimate.velocity_ned_m_s[2]
        self._integral_down = _bounded(
            self._integral_down + parameters["MPC_Z_VEL_I_ACC"] * self._step_s * error,
            _DOWN_INTEGRAL_LIMIT_M_S2,
        )
        return (
            goal.acceleration_ned_m_s2[2]
            + down.acceleration
            + _DRAG_1_S * down.speed
            + parameters["MPC_Z_VEL_P_ACC"] * error
            + self._integral_down
        )

    def _yaw_rate(self, goal: Goal, estimate: Estimate) -> float:
        """A turn at a rate is flown as a rate; the heading it ends at is then kept."""
        turn, wanted = self._turn, goal.yaw_rate_rad_s
        parameters = self._parameters
        limit = math.radians(min(parameters["MPC_YAWRAUTO_MAX"], parameters["MC_YAWRATE_MAX"]))
        acceleration = math.radians(parameters["MPC_YAWRAUTO_ACC"])
        if wanted != wanted:
            wanted = 0.0
        wanted = max(-limit, min(limit, wanted))
        turn.step(wanted, acceleration, acceleration, _YAW_JERK_RAD_S3)
        if goal.yaw_rad == goal.yaw_rad:
            self.yaw_setpoint_rad = goal.yaw_rad
        elif wanted != 0.0 or abs(turn.speed) > _HEADING_LATCH_RAD_S:
            self.yaw_setpoint_rad = estimate.yaw_rad
            return turn.speed
        error = wrap_angle_rad(self.yaw_setpoint_rad - estimate.yaw_rad)
        return max(-limit, min(limit, turn.speed + parameters["MC_YAW_P"] * error))

    def _attitude(
        self, north: float, east: float, down: float, yaw_rad: float, yaw_rate_rad_s: float
    ) -> AttitudeCommand:
        """Points the thrust along the wanted acceleration minus gravity, within the limits."""
        parameters, lift = self._parameters, GRAVITY_M_S2 - down
        lowest = parameters["MPC_THR_MIN"] / self._thrust_per_m_s2
        lift = max(lowest, min(parameters["MPC_THR_MAX"] / self._thrust_per_m_s2, lift))
        cos_yaw, sin_yaw = math.cos(yaw_rad), math.sin(yaw_rad)
        forward, right = cos_yaw * north + sin_yaw * east, cos_yaw * east - sin_yaw * north
        level = math.sqrt(forward * forward + right * right)
        allowed = lift * math.tan(math.radians(parameters["MPC_TILTMAX_AIR"]))
        if level > allowed:
            forward, right = forward * allowed / level, right * allowed / level
        force = math.sqrt(forward * forward + right * right + lift * lift)
        return AttitudeCommand(
            math.asin(right / force),
            -math.atan2(forward, lift),
            yaw_rate_rad_s,
            min(parameters["MPC_THR_MAX"], force * self._thrust_per_m_s2),
        )


def _bounded(value: float, limit: float) -> float:
    return max(-limit, min(limit, value))
