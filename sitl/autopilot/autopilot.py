"""The autopilot: takes commands and setpoints, flies the airframe. No link in here."""

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from companion.kernel.frames import Vector3
from companion.kernel.messages import FlightMode, LandedState
from sitl.airframe import AirframeState
from sitl.autopilot.battery import Battery
from sitl.autopilot.commander import Commander
from sitl.autopilot.control import RELAXED, MotorCommand
from sitl.autopilot.estimation.quality import Quality
from sitl.autopilot.estimation.vision_sample import VisionSample
from sitl.autopilot.estimator import Estimator
from sitl.autopilot.flight import Flight
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
from sitl.autopilot.status import StatusBoard
from sitl.autopilot.vibration import Vibration
from sitl.failures import Failures, Unit
from sitl.sensors.receiver import Receiver
from sitl.sensors.suite import Sensors
from sitl.settings import BatterySettings, EstimatorSettings

CONTROL_HZ: Final = 50


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
        self.failures = Failures()
        self._now_s = now_s
        self._estimator = Estimator(
            estimator, CONTROL_HZ, rng, self.parameters, self.failures, start
        )
        for_readings, for_fixes = rng.spawn(2)
        self._receiver = Receiver(self.parameters, for_fixes)
        self.sensors = Sensors(start, self.parameters, self.failures, self._receiver, for_readings)
        self._home = Home(self.estimate.yaw_rad)
        self._battery = Battery(battery, self.parameters, self.failures)
        self.plans = Plans(self.parameters, self._home)
        self._inputs = Inputs(self.parameters, now_s)
        self._flight = Flight(
            self.parameters, hover_thrust_norm, CONTROL_HZ, self._inputs, self.plans
        )
        self._commander = Commander(
            self.parameters,
            now_s,
            self._estimator,
            self._battery,
            self._inputs,
            self.plans,
            self._flight,
        )
        self._resets = 0
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

    @property
    def estimate(self) -> Estimate:
        return self._estimator.estimate

    def update(self, truth: AirframeState) -> MotorCommand:
        """One step of everything; ``truth`` is what the sensors are made from."""
        self.sensors.truth = truth
        if (fix := self._receiver.update(truth)) is not None:
            self._estimator.take_fix(fix)
        estimate = self._estimator.update(truth)
        if self._estimator.vision.resets != self._resets:
            self._follow_jump(estimate)
        self._vibration.update(estimate)
        self._motors_norm = truth.motors_norm
        self._battery.update(truth.motors_norm, 1.0 / CONTROL_HZ)
        self._flight.blind = not self._estimator.level_valid
        commander = self._commander
        commander.watch()
        if not commander.armed:
            return MotorCommand(False, RELAXED)
        return MotorCommand(
            True, self._flight.step(estimate, commander.mode, commander.may_lift_off)
        )

    def _follow_jump(self, estimate: Estimate) -> None:
        """The position jumped to what external vision sees: home and what is held go with it."""
        self._resets = self._estimator.vision.resets
        if self._commander.armed:
            self._flight.hold_anew()
        else:
            self._home.move(estimate.position_ned_m, estimate.yaw_rad)

    # -- what links ask and command ------------------------------------------------------------

    @property
    def status(self) -> VehicleStatus:
        return self._board.status(self._commander.verdict, self._motors_norm)

    @property
    def quality(self) -> Quality:
        return self._estimator.quality()

    def set_parameter(self, name: str, value: float) -> bool:
        return change_parameter(self.parameters, name, value)

    @property
    def battery_voltage_v(self) -> float:
        return self._battery.voltage_v

    def inject_failure(self, unit: int, kind: int, instance: int) -> Ack:
        if not self.parameters["SYS_FAILURE_EN"]:
            return Ack.DENIED
        return Ack.ACCEPTED if self.failures.inject(unit, kind, instance) else Ack.UNSUPPORTED

    def set_charge(self, charge_norm: float) -> None:
        """A fault of the battery: its state of charge jumps."""
        self._battery.charge_norm = charge_norm

    def set_drift(self, drift_ned_m_s: Vector3) -> None:
        """A fault of the estimator: the velocity is wrong by as much from now on."""
        self._estimator.reckoning.set_drift(drift_ned_m_s)

    def announce(self, severity: Severity, text: str) -> None:
        self._commander.announce(severity, text)

    def drain_status_texts(self) -> list[StatusText]:
        return self._commander.drain_status_texts()

    def arm(self, force: bool = False) -> Ack:
        return self._commander.arm(force)

    def disarm(self, force: bool = False) -> Ack:
        return self._commander.disarm(force)

    def take_off(self, height_m: float = math.nan) -> Ack:
        return self._commander.take_off(height_m)

    def land(self) -> Ack:
        return self._commander.land()

    def set_mode(self, mode: FlightMode) -> Ack:
        return self._commander.set_mode(mode)

    def terminate(self, reason: str) -> None:
        """Motors off at once, wherever the vehicle is."""
        self._commander.terminate(reason)

    def reboot(self) -> Ack:
        return self._commander.reboot()

    def set_offboard_setpoint(self, setpoint: OffboardSetpoint | AttitudeSetpoint) -> None:
        self._inputs.take_setpoint(setpoint)

    def set_manual_input(self, sticks: ManualInput) -> None:
        if self.failures.works(Unit.STICKS):
            self._inputs.take_sticks(sticks)

    def take_vision(self, sample: VisionSample) -> None:
        self._estimator.take_vision(sample, self._now_s())

    def hear_ground_station(self) -> None:
        self._inputs.hear_ground_station()

    def reposition(self, position_ned_m: Vector3, yaw_rad: float, speed_m_s: float) -> Ack:
        if math.isinf(yaw_rad) or any(abs(place) > FARTHEST_M for place in position_ned_m):
            return Ack.DENIED
        if not self.airborne:
            return self._commander.refuse(FlightMode.HOLD)
        self._flight.reposition(position_ned_m, yaw_rad, speed_m_s)
        return self._commander.intend(FlightMode.HOLD)

    def orbit(self, request: OrbitRequest) -> Ack:
        if any(abs(place) > FARTHEST_M for place in request.centre_ned_m):
            return Ack.DENIED
        if not self.airborne:
            return self._commander.refuse(FlightMode.ORBIT)
        self._flight.orbit(request, self.estimate)
        return self._commander.intend(FlightMode.ORBIT)

    def change_speed(self, speed_m_s: float) -> Ack:
        self._flight.cruise_m_s = speed_m_s
        return Ack.ACCEPTED

    def set_home(self, position_ned_m: Vector3 | None) -> Ack:
        place = self.estimate.position_ned_m if position_ned_m is None else position_ned_m
        known, yaw_rad = self._estimator.ready(self.estimate.time_s), self.estimate.yaw_rad
        return Ack.ACCEPTED if known and self._home.move(place, yaw_rad) else Ack.DENIED
