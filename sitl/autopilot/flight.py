"""Carrying out a mode, from the ground up and down to it again."""

from typing import Final

from companion.kernel.frames import Vector3
from companion.kernel.messages import NAN, FlightMode, LandedState
from sitl.autopilot.attitude import attitude_command
from sitl.autopilot.control import RELAXED, AttitudeCommand, Controller, Goal
from sitl.autopilot.ground import GroundDetector, GroundState
from sitl.autopilot.inputs import Inputs
from sitl.autopilot.interface import (
    NAN3,
    AttitudeSetpoint,
    Estimate,
    OffboardSetpoint,
    OrbitRequest,
    OrbitStatus,
)
from sitl.autopilot.manual import Altitude, Position
from sitl.autopilot.mission_flight import FlyMission
from sitl.autopilot.modes import Descend, GoTo, Hold, Land, Mode, Offboard, TakeOff
from sitl.autopilot.orbit import Orbit
from sitl.autopilot.parameters import Number
from sitl.autopilot.plans import Plans
from sitl.autopilot.returning import Return

_SINKS_M_S: Final = 1.0  # what less thrust than the weight is taken to mean, without a controller


class Flight:
    """One vehicle's motion. ``step`` is to be called at a steady rate while the motors turn."""

    def __init__(
        self,
        parameters: dict[str, Number],
        hover_thrust_norm: float,
        update_hz: int,
        inputs: Inputs,
        plans: Plans,
    ) -> None:
        self._parameters = parameters
        self._inputs = inputs
        self._plans = plans
        self._hover_norm = hover_thrust_norm
        self.controller = Controller(parameters, hover_thrust_norm, update_hz)
        self.ground = GroundDetector(parameters, update_hz)
        self.take_off_height_m = NAN
        """What the next take-off climbs to."""
        self.cruise_m_s = NAN
        """On the way to a place; NaN for MPC_XY_CRUISE."""
        self.blind = False
        """Whether the place is not known; landing then goes straight down."""
        self.stop()

    def stop(self) -> None:
        """The motors were switched off."""
        self.ground.stand()
        self.goal = Goal()
        self.command = RELAXED
        self._orbit: Orbit | None = None
        self._flown: tuple[FlightMode, bool] | None = None
        """The mode, and whether it was begun blind."""
        self._mode: Mode = Hold()

    @property
    def airborne(self) -> bool:
        return not self.ground.standing

    @property
    def next_mode(self) -> FlightMode | None:
        """What comes by itself after the mode that is flown; None while it goes on."""
        mode = self._mode
        if isinstance(mode, FlyMission) and mode.over:
            return FlightMode.RTL if mode.calls_for_return else FlightMode.HOLD
        return FlightMode.HOLD if isinstance(mode, TakeOff) and mode.done else None

    @property
    def landed_state(self) -> LandedState:
        if self.ground.standing:
            return LandedState.ON_GROUND
        if self.ground.state is GroundState.LIFTING_OFF:
            return LandedState.TAKING_OFF
        leg = self._mode.leg
        if isinstance(leg, TakeOff):
            return LandedState.TAKING_OFF if leg.low else LandedState.IN_AIR
        return LandedState.LANDING if isinstance(leg, Land) else LandedState.IN_AIR

    def reposition(self, position_ned_m: Vector3, yaw_rad: float, speed_m_s: float) -> None:
        """Holds there from now on; axes of NaN stay where the vehicle comes to rest."""
        if speed_m_s == speed_m_s:  # not NaN
            self.cruise_m_s = speed_m_s
        self._mode = GoTo(position_ned_m, self._cruise_m_s, yaw_rad)
        self._flown = FlightMode.HOLD, self.blind

    def hold_anew(self) -> None:
        """The estimate jumped: a place that was only held is where the vehicle is now."""
        if isinstance(self._mode, Hold | Land | Position):
            self._flown = None

    def orbit(self, request: OrbitRequest, estimate: Estimate) -> None:
        """From now on, or changes the orbit that is flown."""
        if self._orbit is None or self._mode is not self._orbit:
            self._orbit = Orbit(estimate, self._parameters)
        self._orbit.take(request, estimate)
        self._mode, self._flown = self._orbit, (FlightMode.ORBIT, self.blind)

    @property
    def orbit_status(self) -> OrbitStatus | None:
        """None unless one is flown."""
        return self._mode.status if isinstance(self._mode, Orbit) else None

    def _cruise_m_s(self) -> float:
        asked = self.cruise_m_s == self.cruise_m_s  # not NaN
        return self.cruise_m_s if asked else self._parameters["MPC_XY_CRUISE"]

    def feel_ground(self, estimate: Estimate) -> None:
        lift_norm = self.command.thrust_norm / self._hover_norm
        descent_m_s = self.controller.descent_setpoint_m_s
        attitude = self._attitude_setpoint()
        if attitude is not None:  # what is asked for: at lift-off the thrust given is less
            descent_m_s = _SINKS_M_S if attitude.thrust_norm < self._hover_norm else 0.0
        self.ground.update(estimate, descent_m_s, lift_norm)

    def step(self, estimate: Estimate, mode: FlightMode, may_lift_off: bool) -> AttitudeCommand:
        """What the airframe is to do now to follow ``mode``."""
        if (mode, self.blind) != self._flown:
            self._mode = self._begin(mode, estimate)
            self._flown = mode, self.blind
        setpoint = self._inputs.setpoint
        if isinstance(self._mode, Offboard) and isinstance(setpoint, OffboardSetpoint):
            self._mode.setpoint = setpoint
        elif isinstance(self._mode, Position):
            self._mode.sticks = self._inputs.sticks
        if self.ground.standing and may_lift_off and self._wants_up(estimate):
            self.ground.lift_off(estimate)
        self.command = self._command(estimate)
        return self.command

    def _command(self, estimate: Estimate) -> AttitudeCommand:
        ground, attitude = self.ground, self._attitude_setpoint()
        if ground.standing:
            self._mode.stand(estimate)
        if ground.standing or ground.state is GroundState.TOUCHING:
            self.controller.reset(estimate)
            return RELAXED
        self.goal = self._mode.goal(estimate) if attitude is None else Goal()
        ramp_s = self._parameters["MPC_TKO_RAMP_T"]
        if ground.state is GroundState.LIFTING_OFF and ground.time_in_state_s < ramp_s:
            self.controller.reset(estimate)
            lift_norm = ground.time_in_state_s / ramp_s
            return AttitudeCommand(0.0, 0.0, 0.0, self._hover_norm * lift_norm)
        if attitude is not None:
            self.controller.reset(estimate)
            return attitude_command(attitude, estimate, self._parameters)
        return self.controller.update(self.goal, estimate)

    def _attitude_setpoint(self) -> AttitudeSetpoint | None:
        """What offboard mode flies past the controller, if that is what it flies."""
        setpoint = self._inputs.setpoint
        by_attitude = isinstance(self._mode, Offboard) and isinstance(setpoint, AttitudeSetpoint)
        return setpoint if by_attitude and isinstance(setpoint, AttitudeSetpoint) else None

    def _begin(self, mode: FlightMode, estimate: Estimate) -> Mode:
        parameters, setpoint = self._parameters, self._inputs.setpoint
        if mode is FlightMode.TAKEOFF:
            return TakeOff(estimate, self.take_off_height_m, parameters)
        if mode is FlightMode.LAND:
            return Descend(parameters) if self.blind else Land(parameters)
        if mode is FlightMode.OFFBOARD:
            return Offboard(
                setpoint if isinstance(setpoint, OffboardSetpoint) else OffboardSetpoint()
            )
        if mode is FlightMode.POSITION:
            return Position(self._inputs.sticks, parameters)
        if mode is FlightMode.ALTITUDE:
            return Altitude(self._inputs.sticks, parameters)
        if mode is FlightMode.MISSION:
            return FlyMission(self._plans.mission, self.ground, parameters)
        if mode is FlightMode.RTL:
            places = (self._plans.home.position_ned_m, *self._plans.rally_ned_m)
            return Return(estimate, places, lambda: parameters["MPC_XY_CRUISE"], parameters)
        if mode is FlightMode.ORBIT and self._orbit is not None:
            return self._orbit
        return Hold(self.goal.position_ned_m if self.next_mode is FlightMode.HOLD else NAN3)

    def _wants_up(self, estimate: Estimate) -> bool:
        attitude = self._attitude_setpoint()
        if attitude is not None:
            return attitude.thrust_norm > self._hover_norm
        if isinstance(self._mode, Offboard):
            return self._mode.wants_up(estimate)
        if isinstance(self._mode, Position):
            return self._mode.wants_up
        return isinstance(self._mode.leg, TakeOff)
