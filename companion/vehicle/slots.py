"""The newest of each telemetry stream, as `Telemetry`; written on MAVSDK's thread, read on ours.

Each slot is one reference, replaced whole, so no lock is needed.
"""

import math
from typing import Any, TypeAlias

from companion.kernel.clock import wall_s
from companion.kernel.frames import Vector3, euler_from_quaternion
from companion.kernel.messages import NAN, FlightMode, LandedState, Telemetry

MavsdkData: TypeAlias = Any
"""An object of MAVSDK, which is untyped and imported by its adapter alone."""

FLIGHT_MODES: dict[str, FlightMode] = {
    "MANUAL": FlightMode.MANUAL,
    "STABILIZED": FlightMode.MANUAL,
    "ACRO": FlightMode.MANUAL,
    "ALTCTL": FlightMode.ALTITUDE,
    "POSCTL": FlightMode.POSITION,
    "TAKEOFF": FlightMode.TAKEOFF,
    "HOLD": FlightMode.HOLD,
    "MISSION": FlightMode.MISSION,
    "RETURN_TO_LAUNCH": FlightMode.RTL,
    "LAND": FlightMode.LAND,
    "OFFBOARD": FlightMode.OFFBOARD,
}
"""By MAVSDK's names; any other is UNKNOWN."""

LANDED_STATES: dict[str, LandedState] = {
    "ON_GROUND": LandedState.ON_GROUND,
    "TAKING_OFF": LandedState.TAKING_OFF,
    "IN_AIR": LandedState.IN_AIR,
    "LANDING": LandedState.LANDING,
}


class TelemetrySlots:
    """``on_...`` are MAVSDK's callbacks."""

    def __init__(self) -> None:
        self.heard_wall_s = -math.inf
        """When the newest odometry came."""
        self.missing_for_arming = "no health report yet"
        self._odometry: MavsdkData = None
        self._velocity_ned_m_s: Vector3 = (NAN, NAN, NAN)
        self._armed = False
        self._mode_heard = False
        self._flight_mode = FlightMode.UNKNOWN
        self._landed_state = LandedState.UNKNOWN
        self._battery_norm = NAN

    def subscribe(self, plugin: MavsdkData) -> None:
        """Fills the slots from MAVSDK's telemetry plugin from now on."""
        plugin.subscribe_odometry(self.on_odometry)
        plugin.subscribe_position_velocity_ned(self.on_position_velocity)
        plugin.subscribe_armed(self.on_armed)
        plugin.subscribe_flight_mode(self.on_flight_mode)
        plugin.subscribe_landed_state(self.on_landed_state)
        plugin.subscribe_battery(self.on_battery)
        plugin.subscribe_health(self.on_health)

    @property
    def complete(self) -> bool:
        """Whether an estimate and a heartbeat have come, so that no field is a mere default."""
        return self._odometry is not None and self._mode_heard

    def telemetry(self) -> Telemetry:
        odometry = self._odometry
        if odometry is None:
            return Telemetry()
        position, q = odometry.position_body, odometry.q
        roll_rad, pitch_rad, yaw_rad = euler_from_quaternion((q.w, q.x, q.y, q.z))
        return Telemetry(
            stamp_ns=odometry.time_usec * 1000,
            position_ned_m=(position.x_m, position.y_m, position.z_m),
            velocity_ned_m_s=self._velocity_ned_m_s,
            roll_rad=roll_rad,
            pitch_rad=pitch_rad,
            yaw_rad=yaw_rad,
            yaw_rate_rad_s=odometry.angular_velocity_body.yaw_rad_s,
            armed=self._armed,
            flight_mode=self._flight_mode,
            landed_state=self._landed_state,
            battery_norm=self._battery_norm,
            connected=True,
        )

    def on_odometry(self, odometry: MavsdkData, _: object) -> None:
        """Position in NED, in spite of its name. Its velocity is in NED or FRD, which MAVSDK does
        not tell apart; `on_position_velocity` has it in NED for certain.
        """
        self._odometry = odometry
        self.heard_wall_s = wall_s()

    def on_position_velocity(self, motion: MavsdkData, _: object) -> None:
        v = motion.velocity
        self._velocity_ned_m_s = (v.north_m_s, v.east_m_s, v.down_m_s)

    def on_armed(self, armed: bool, _: object) -> None:
        self._armed = bool(armed)

    def on_flight_mode(self, mode: MavsdkData, _: object) -> None:
        self._flight_mode = FLIGHT_MODES.get(mode.name, FlightMode.UNKNOWN)
        self._mode_heard = True

    def on_landed_state(self, state: MavsdkData, _: object) -> None:
        self._landed_state = LANDED_STATES.get(state.name, LandedState.UNKNOWN)

    def on_battery(self, battery: MavsdkData, _: object) -> None:
        """Less than nothing means that the autopilot does not measure it."""
        percent = battery.remaining_percent
        self._battery_norm = percent / 100.0 if percent >= 0.0 else NAN

    def on_health(self, health: MavsdkData, _: object) -> None:
        missing = [
            text
            for text, ok in (
                ("gyrometer", health.is_gyrometer_calibration_ok),
                ("accelerometer", health.is_accelerometer_calibration_ok),
                ("local position", health.is_local_position_ok),
                ("pre-arm checks", health.is_armable),
            )
            if not ok
        ]
        self.missing_for_arming = ", ".join(missing)
