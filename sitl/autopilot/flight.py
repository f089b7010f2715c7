"""Carrying out a mode, from the ground up and down to it again."""

from companion.kernel.frames import Vector3
from companion.kernel.messages import NAN, FlightMode, LandedState
from sitl.autopilot.control import RELAXED, AttitudeCommand, Controller, Goal
from sitl.autopilot.ground import GroundDetector, GroundState
from sitl.autopilot.interface import NAN3, Estimate, OffboardSetpoint
from sitl.autopilot.modes import GoTo, Hold, Land, Mode, Offboard, TakeOff
from sitl.autopilot.parameters import Number


class Flight:
    """One vehicle's motion. ``step`` is to be called at a steady rate while the motors turn."""

    def __init__(
        self, parameters: dict[str, Number], hover_thrust_norm: float, update_hz: int
    ) -> None:
        self._parameters = parameters
        self._hover_norm = hover_thrust_norm
        self.controller = Controller(parameters, hover_thrust_norm, update_hz)
        self.ground = GroundDetector(parameters, update_hz)
        self.setpoint = OffboardSetpoint()
        """What offboard mode flies."""
        self.take_off_height_m = NAN
        """What the next take-off climbs to."""
        self.cruise_m_s = NAN
        """On the way to a place; NaN for MPC_XY_CRUISE."""
        self.stop()

    def stop(self) -> None:
        """The motors were switched off."""
        self.ground.stand()
        self.goal = Goal()
        self.command = RELAXED
        self._flown: FlightMode | None = None
        self._mode: Mode = Hold()

    @property
    def airborne(self) -> bool:
        return not self.ground.standing

    @property
    def take_off_done(self) -> bool:
        return isinstance(self._mode, TakeOff) and self._mode.done

    @property
    def landed_state(self) -> LandedState:
        if self.ground.standing:
            return LandedState.ON_GROUND
        if self.ground.state is GroundState.LIFTING_OFF:
            return LandedState.TAKING_OFF
        if isinstance(self._mode, TakeOff):
            return LandedState.TAKING_OFF if self._mode.low else LandedState.IN_AIR
        return LandedState.LANDING if isinstance(self._mode, Land) else LandedState.IN_AIR

    def reposition(self, position_ned_m: Vector3, yaw_rad: float, speed_m_s: float) -> None:
        """Holds there from now on; axes of NaN stay where the vehicle comes to rest."""
        if speed_m_s == speed_m_s:  # not NaN
            self.cruise_m_s = speed_m_s
        self._mode = GoTo(position_ned_m, self._cruise_m_s, yaw_rad)
        self._flown = FlightMode.HOLD

    def _cruise_m_s(self) -> float:
        asked = self.cruise_m_s == self.cruise_m_s  # not NaN
        return self.cruise_m_s if asked else self._parameters["MPC_XY_CRUISE"]

    def feel_ground(self, estimate: Estimate) -> None:
        lift_norm = self.command.thrust_norm / self._hover_norm
        self.ground.update(estimate, self.controller.descent_setpoint_m_s, lift_norm)

    def step(self, estimate: Estimate, mode: FlightMode, may_lift_off: bool) -> AttitudeCommand:
        """What the airframe is to do now to follow ``mode``."""
        if mode is not self._flown:
            self._mode = self._begin(mode, estimate)
            self._flown = mode
        if isinstance(self._mode, Offboard):
            self._mode.setpoint = self.setpoint
        if self.ground.standing and may_lift_off and self._wants_up(estimate):
            self.ground.lift_off(estimate)
        self.command = self._command(estimate)
        return self.command

    def _command(self, estimate: Estimate) -> AttitudeCommand:
        ground = self.ground
        if ground.standing or ground.state is GroundState.TOUCHING:
            self.controller.reset(estimate)
            return RELAXED
        self.goal = self._mode.goal(estimate)
        ramp_s = self._parameters["MPC_TKO_RAMP_T"]
        if ground.state is GroundState.LIFTING_OFF and ground.time_in_state_s < ramp_s:
            self.controller.reset(estimate)
            lift_norm = ground.time_in_state_s / ramp_s
            return AttitudeCommand(0.0, 0.0, 0.0, self._hover_norm * lift_norm)
        return self.controller.update(self.goal, estimate)

    def _begin(self, mode: FlightMode, estimate: Estimate) -> Mode:
        if mode is FlightMode.TAKEOFF:
            return TakeOff(estimate, self.take_off_height_m, self._parameters)
        if mode is FlightMode.LAND:
            return Land(self._parameters)
        if mode is FlightMode.OFFBOARD:
            return Offboard(self.setpoint)
        return Hold(self.goal.position_ned_m if self.take_off_done else NAN3)

    def _wants_up(self, estimate: Estimate) -> bool:
        if isinstance(self._mode, Offboard):
            return self._mode.wants_up(estimate)
        return isinstance(self._mode, TakeOff)
