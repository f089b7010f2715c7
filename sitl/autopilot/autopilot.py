"""The autopilot: takes commands and setpoints, flies the airframe. No link in here."""

import math
from collections import deque
from collections.abc import Callable
from typing import Final

import numpy as np

from companion.kernel.frames import Vector3
from companion.kernel.messages import FlightMode, LandedState
from sitl.airframe import AirframeState
from sitl.autopilot.arming import Arming
from sitl.autopilot.battery import Battery
from sitl.autopilot.control import RELAXED, MotorCommand
from sitl.autopilot.estimator import Estimator
from sitl.autopilot.failsafe import Failsafe, Situation
from sitl.autopilot.flight import Flight
from sitl.autopilot.ground import GroundState
from sitl.autopilot.home import FARTHEST_M, Home
from sitl.autopilot.inputs import Inputs
from sitl.autopilot.interface import (
    Ack,
    AttitudeSetpoint,
    Estimate,
    ManualInput,
    OffboardSetpoint,
    OrbitRequest,
    Severity,
    StatusText,
    VehicleStatus,
)
from sitl.autopilot.parameters import change_parameter, default_parameters
from sitl.autopilot.plans import Plans
from sitl.autopilot.reactions import ACTION_MODES, Action
from sitl.autopilot.readiness import Readiness
from sitl.autopilot.status import StatusBoard, Verdict
from sitl.autopilot.vibration import Vibration
from sitl.settings import BatterySettings, EstimatorSettings

CONTROL_HZ: Final = 50
_TEXTS_KEPT: Final = 500  # while no link takes them; then the oldest go


class Autopilot:
    """Implements ``AutopilotPort``. The world calls ``update`` at ``CONTROL_HZ``.

    ``now_s`` is the world's time: it stamps setpoints that arrive between two updates.
    """

    def __init__(
        self,
        start: AirframeState,
        hover_thrust_norm: float,
        now_s: Callable[[], float],
        rng: np.random.Generator,
        estimator: EstimatorSettings,
        battery: BatterySettings,
    ) -> None:
        self.parameters = default_parameters()
        self._now_s = now_s
        self._estimator = Estimator(estimator, CONTROL_HZ, rng)
        self.estimate: Estimate = self._estimator.update(start)
        self._home = Home(self.estimate.yaw_rad)
        self._battery = Battery(battery, self.parameters)
        self.plans = Plans(self.parameters, self._home)
        self._inputs = Inputs(self.parameters, now_s)
        self._flight = Flight(
            self.parameters, hover_thrust_norm, CONTROL_HZ, self._inputs, self.plans
        )
        self._readiness = Readiness(self.parameters, self._battery, self._inputs, self.plans)
        self._arming = Arming(self.parameters)
        self._failsafe = Failsafe(self.parameters, self._inputs)
        self._texts: deque[StatusText] = deque(maxlen=_TEXTS_KEPT)
        self._ready = False
        self._intended = FlightMode.HOLD
        self._motors_norm = start.motors_norm
        self._vibration = Vibration()
        self._board = StatusBoard(
            self._flight, self._battery, self.plans, self._home, self._vibration
        )

    @property
    def airborne(self) -> bool:
        return self._flight.airborne

    @property
    def landed_state(self) -> LandedState:
        return self._flight.landed_state

    # -- what links ask and command ------------------------------------------------------------

    @property
    def status(self) -> VehicleStatus:
        verdict = Verdict(
            armed=self._arming.armed,
            mode=self._mode_now(),
            intended_mode=self._intended,
            ready_to_arm=self._ready,
            failsafe=self._failsafe.active,
        )
        return self._board.status(verdict, self._motors_norm)

    def set_parameter(self, name: str, value: float) -> bool:
        return change_parameter(self.parameters, name, value)

    def set_charge(self, charge_norm: float) -> None:
        """A fault of the battery: its state of charge jumps."""
        self._battery.charge_norm = charge_norm

    def drain_status_texts(self) -> list[StatusText]:
        texts = list(self._texts)
        self._texts.clear()
        return texts

    def arm(self, force: bool = False) -> Ack:
        if self._arming.armed:
            return Ack.ACCEPTED
        problems = self._arming_problems()
        if problems and not force:
            self.announce(Severity.CRITICAL, f"Arming denied: {', '.join(problems)}")
            return Ack.TEMPORARILY_REJECTED
        self._arming.arm(self._now_s())
        self.announce(Severity.INFO, "Armed by external command")
        return Ack.ACCEPTED

    def disarm(self, force: bool = False) -> Ack:
        if self.airborne and not force:
            self.announce(Severity.CRITICAL, "Disarming denied: not landed")
            return Ack.TEMPORARILY_REJECTED
        if self._arming.armed:
            self._stop_motors("Disarmed by external command")
        return Ack.ACCEPTED

    def take_off(self, height_m: float = math.nan) -> Ack:
        wanted_m = self.parameters["MIS_TAKEOFF_ALT"] if math.isnan(height_m) else height_m
        if not 0.0 < wanted_m < math.inf:
            return Ack.DENIED
        again = wanted_m == self._flight.take_off_height_m and self._intended is FlightMode.TAKEOFF
        if again and self._failsafe.action <= Action.WARN:
            return Ack.ACCEPTED
        if self.airborne:
            return self._refuse(FlightMode.TAKEOFF)
        self._flight.take_off_height_m = wanted_m
        return self._intend(FlightMode.TAKEOFF)

    def land(self) -> Ack:
        if not self._arming.armed:
            return Ack.ACCEPTED
        return self._intend(FlightMode.LAND)

    def set_mode(self, mode: FlightMode) -> Ack:
        if mode is FlightMode.LAND:
            return self.land()
        if mode is FlightMode.TAKEOFF:
            return self.take_off()
        if self._readiness.available(mode, self._arming.armed):
            return self._intend(mode)
        problem = self._readiness.mission_problem() if mode is FlightMode.MISSION else None
        if problem is not None:
            self.announce(Severity.CRITICAL, problem)
        return self._refuse(mode)

    def set_offboard_setpoint(self, setpoint: OffboardSetpoint | AttitudeSetpoint) -> None:
        self._inputs.take_setpoint(setpoint)

    def set_manual_input(self, sticks: ManualInput) -> None:
        self._inputs.take_sticks(sticks)

    def hear_ground_station(self) -> None:
        self._inputs.hear_ground_station()

    def announce(self, severity: Severity, text: str) -> None:
        self._texts.append(StatusText(self._now_s(), severity, text))

    def reposition(self, position_ned_m: Vector3, yaw_rad: float, speed_m_s: float) -> Ack:
        if math.isinf(yaw_rad) or any(abs(place) > FARTHEST_M for place in position_ned_m):
            return Ack.DENIED
        if not self.airborne:
            return self._refuse(FlightMode.HOLD)
        self._flight.reposition(position_ned_m, yaw_rad, speed_m_s)
        return self._intend(FlightMode.HOLD)

    def orbit(self, request: OrbitRequest) -> Ack:
        if any(abs(place) > FARTHEST_M for place in request.centre_ned_m):
            return Ack.DENIED
        if not self.airborne:
            return self._refuse(FlightMode.ORBIT)
        self._flight.orbit(request, self.estimate)
        return self._intend(FlightMode.ORBIT)

    def change_speed(self, speed_m_s: float) -> Ack:
        self._flight.cruise_m_s = speed_m_s
        return Ack.ACCEPTED

    def set_home(self, position_ned_m: Vector3 | None) -> Ack:
        place = self.estimate.position_ned_m if position_ned_m is None else position_ned_m
        known, yaw_rad = self._estimator.ready(self.estimate.time_s), self.estimate.yaw_rad
        return Ack.ACCEPTED if known and self._home.move(place, yaw_rad) else Ack.DENIED

    def reboot(self) -> Ack:
        if self._arming.armed:
            self.announce(Severity.CRITICAL, "Reboot denied: armed")
            return Ack.TEMPORARILY_REJECTED
        self._texts.clear()
        self._estimator.restart(self._now_s())
        self._inputs.forget()
        self._ready, self._intended = False, FlightMode.HOLD
        return Ack.ACCEPTED

    def terminate(self, reason: str) -> None:
        """Motors off at once, wherever the vehicle is."""
        if self._arming.armed:
            self.announce(Severity.CRITICAL, f"Flight terminated: {reason}")
            self._stop_motors("Disarmed by failure detector")

    # -- flying --------------------------------------------------------------------------------

    def update(self, truth: AirframeState) -> MotorCommand:
        """One step of everything; ``truth`` is what the sensors are made from."""
        self.estimate = estimate = self._estimator.update(truth)
        self._vibration.update(estimate)
        self._motors_norm = truth.motors_norm
        self._battery.update(truth.motors_norm, 1.0 / CONTROL_HZ)
        if self._arming.armed:
            self._feel_ground(estimate)
            if self.airborne:
                self._watch(estimate)
                self._heed_pilot()
        if not self._arming.armed:
            self._announce_readiness()
            return MotorCommand(False, RELAXED)
        self._go_on()
        may_lift_off = self._arming.spooled_up(estimate.time_s) and not (
            self._intended is FlightMode.OFFBOARD and self._inputs.setpoints_lost
        )
        return MotorCommand(True, self._flight.step(estimate, self._mode_now(), may_lift_off))

    def _go_on(self) -> None:
        """Enters the mode that follows on a take-off or a mission, once that is done."""
        following = self._flight.next_mode
        if following is None or self._mode_now() is not self._intended:
            return
        if self._intended is FlightMode.MISSION:
            self.announce(Severity.INFO, "Mission finished")
        self._intended = following

    def _feel_ground(self, estimate: Estimate) -> None:
        """Reports lift-off and touch-down, and disarms what has stood for long enough."""
        ground, before = self._flight.ground, self._flight.ground.state
        self._flight.feel_ground(estimate)
        if before is GroundState.LIFTING_OFF and ground.state is GroundState.FLYING:
            self._arming.left_ground()
            self.announce(Severity.INFO, "Takeoff detected")
        elif ground.standing and before is not GroundState.STANDING:
            self._arming.touched_ground(estimate.time_s)
            self.announce(Severity.INFO, "Landing detected")
        if reason := self._arming.reason_to_disarm(estimate.time_s, ground.standing):
            self._stop_motors(reason)

    def _watch(self, estimate: Estimate) -> None:
        """Lets the failsafes judge."""
        before = self._failsafe.action
        inside = self.plans.inside_fence(estimate.position_ned_m)
        causes = self._failsafe.update(
            Situation(self._intended, estimate, self._battery.charge_norm, inside)
        )
        if (words := self._failsafe.words(before)) is not None:
            self.announce(Severity.CRITICAL, words)
        for cause in causes:
            self.announce(Severity.WARNING, cause)
        if self._failsafe.action is Action.TERMINATE:
            self.terminate(", ".join(self._failsafe.causes))

    def _heed_pilot(self) -> None:
        if self._inputs.pilot_takes(self._mode_now()):
            self._intend(FlightMode.POSITION)
            self.announce(Severity.INFO, "Pilot took over using sticks")

    # -- small questions -----------------------------------------------------------------------

    def _mode_now(self) -> FlightMode:
        """The commanded mode, unless a failsafe has taken over."""
        return ACTION_MODES.get(self._failsafe.action, self._intended)

    def _arming_problems(self) -> list[str]:
        ready = self._estimator.ready(self.estimate.time_s)
        return self._readiness.arming_problems(self._intended, self.estimate, ready)

    # -- changes of state ----------------------------------------------------------------------

    def _announce_readiness(self) -> None:
        ready = not self._arming_problems()
        if ready and not self._ready:
            self.announce(Severity.INFO, "Ready for takeoff!")
        self._ready = ready

    def _intend(self, mode: FlightMode) -> Ack:
        if mode is FlightMode.MISSION and self.plans.mission.complete:
            self.plans.mission.restart()
        self._intended = mode
        self._failsafe.overrule()
        return Ack.ACCEPTED

    def _refuse(self, mode: FlightMode) -> Ack:
        self.announce(Severity.CRITICAL, f"Mode {mode.value} is not available now")
        return Ack.TEMPORARILY_REJECTED

    def _stop_motors(self, reason: str) -> None:
        self.announce(Severity.INFO, reason)
        self._arming.disarm()
        self._flight.stop()
        self._failsafe.reset()
        self._intended = FlightMode.HOLD
