"""What the autopilot's parts know, gathered for its links."""

from typing import NamedTuple

from companion.kernel.messages import FlightMode
from sitl.autopilot.battery import Battery
from sitl.autopilot.flight import Flight
from sitl.autopilot.home import Home
from sitl.autopilot.interface import VehicleStatus
from sitl.autopilot.plans import Plans
from sitl.autopilot.vibration import Vibration


class Verdict(NamedTuple):
    """What the autopilot has decided; named as in VehicleStatus."""

    armed: bool
    mode: FlightMode
    intended_mode: FlightMode
    ready_to_arm: bool
    failsafe: bool


class StatusBoard:
    def __init__(
        self, flight: Flight, battery: Battery, plans: Plans, home: Home, vibration: Vibration
    ) -> None:
        self._flight = flight
        self._battery = battery
        self._plans = plans
        self._home = home
        self._vibration = vibration

    def status(
        self, verdict: Verdict, motors_norm: tuple[float, float, float, float]
    ) -> VehicleStatus:
        flight, command = self._flight, self._flight.command
        return VehicleStatus(
            **verdict._asdict(),
            landed_state=flight.landed_state,
            battery_voltage_v=self._battery.voltage_v,
            battery_current_a=self._battery.current_a,
            battery_norm=self._battery.charge_norm,
            motors_norm=motors_norm,
            position_setpoint_ned_m=flight.goal.position_ned_m,
            velocity_setpoint_ned_m_s=flight.controller.velocity_setpoint_ned_m_s,
            yaw_setpoint_rad=flight.controller.yaw_setpoint_rad,
            thrust_norm=command.thrust_norm,
            roll_setpoint_rad=command.roll_rad,
            pitch_setpoint_rad=command.pitch_rad,
            yaw_rate_setpoint_rad_s=command.yaw_rate_rad_s,
            mission=self._plans.mission.progress(verdict.mode is FlightMode.MISSION),
            home_ned_m=self._home.position_ned_m,
            home_yaw_rad=self._home.yaw_rad,
            gyro_vibration_rad_s=self._vibration.gyro_rad_s,
            acceleration_vibration_m_s2=self._vibration.acceleration_m_s2,
            orbit=flight.orbit_status,
        )
