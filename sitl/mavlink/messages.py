"""The vehicle's state as MAVLink messages; units and frames are converted here and nowhere else."""

import math
from collections.abc import Callable
from typing import NamedTuple

from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.frames import quaternion_from_euler
from companion.kernel.messages import NAN
from sitl.autopilot.interface import Estimate, VehicleStatus
from sitl.mavlink import modes

HOME_LATITUDE_DEG = 51.9906
HOME_LONGITUDE_DEG = 4.3768
HOME_AMSL_M = 10.0
"""Where local (0, 0, 0) is said to be on Earth: a flight hall in Delft. There is no GPS indoors."""

METRES_PER_DEGREE = 111_319.5
"""Along a meridian, or along the equator; a room is too small for the difference to matter."""

_PX4_VERSION = 1 << 24 | 17 << 16 | 0 << 8 | 255
_CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)
_SENSORS_ALWAYS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
    | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
)
_SENSORS_WHEN_READY = (
    mavlink.MAV_SYS_STATUS_SENSOR_OPTICAL_FLOW
    | mavlink.MAV_SYS_STATUS_AHRS
    | mavlink.MAV_SYS_STATUS_PREARM_CHECK
)
_ESTIMATES_WHEN_READY = (
    mavlink.ESTIMATOR_VELOCITY_HORIZ
    | mavlink.ESTIMATOR_VELOCITY_VERT
    | mavlink.ESTIMATOR_POS_HORIZ_REL
    | mavlink.ESTIMATOR_POS_VERT_ABS
    | mavlink.ESTIMATOR_POS_VERT_AGL
)
_IMU_FIELDS_UPDATED = 0x3F  # three accelerations, three rates
_UNKNOWN_COVARIANCE = [NAN] * 21
_UNKNOWN_UINT16 = 0xFFFF


class Snapshot(NamedTuple):
    """One moment of the vehicle, from which every message of that moment is built."""

    estimate: Estimate
    status: VehicleStatus

    @property
    def boot_ms(self) -> int:
        return round(self.estimate.time_s * 1e3)

    @property
    def boot_us(self) -> int:
        return round(self.estimate.time_s * 1e6)

    @property
    def ready(self) -> bool:
        return self.status.ready_to_arm or self.status.armed

    @property
    def height_m(self) -> float:
        return -self.estimate.position_ned_m[2]


Message = mavlink.MAVLink_message
Builder = Callable[[Snapshot], Message]


def heartbeat(now: Snapshot) -> Message:
    status = now.status
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_QUADROTOR,
        mavlink.MAV_AUTOPILOT_PX4,
        modes.base_mode(status.mode, status.armed),
        modes.custom_mode(status.mode),
        modes.system_status(status.ready_to_arm, status.armed, status.failsafe),
        3,
    )


def attitude(now: Snapshot) -> Message:
    e = now.estimate
    return mavlink.MAVLink_attitude_message(
        now.boot_ms, e.roll_rad, e.pitch_rad, e.yaw_rad, *e.rates_frd_rad_s
    )


def attitude_quaternion(now: Snapshot) -> Message:
    e = now.estimate
    q = quaternion_from_euler(e.roll_rad, e.pitch_rad, e.yaw_rad)
    return mavlink.MAVLink_attitude_quaternion_message(now.boot_ms, *q, *e.rates_frd_rad_s)


def local_position_ned(now: Snapshot) -> Message:
    e = now.estimate
    return mavlink.MAVLink_local_position_ned_message(
        now.boot_ms, *e.position_ned_m, *e.velocity_ned_m_s
    )


def odometry(now: Snapshot) -> Message:
    """Velocity in NED, as PX4's EKF2 publishes it; child_frame_id says so."""
    e = now.estimate
    return mavlink.MAVLink_odometry_message(
        now.boot_us,
        mavlink.MAV_FRAME_LOCAL_NED,
        mavlink.MAV_FRAME_LOCAL_NED,
        *e.position_ned_m,
        quaternion_from_euler(e.roll_rad, e.pitch_rad, e.yaw_rad),
        *e.velocity_ned_m_s,
        *e.rates_frd_rad_s,
        _UNKNOWN_COVARIANCE,
        _UNKNOWN_COVARIANCE,
        0,
        mavlink.MAV_ESTIMATOR_TYPE_AUTOPILOT,
        100 if now.ready else 0,
    )


def global_position_int(now: Snapshot) -> Message:
    north_m, east_m, _ = now.estimate.position_ned_m
    metres_per_degree_east = METRES_PER_DEGREE * math.cos(math.radians(HOME_LATITUDE_DEG))
    return mavlink.MAVLink_global_position_int_message(
        now.boot_ms,
        round((HOME_LATITUDE_DEG + north_m / METRES_PER_DEGREE) * 1e7),
        round((HOME_LONGITUDE_DEG + east_m / metres_per_degree_east) * 1e7),
        round((HOME_AMSL_M + now.height_m) * 1e3),
        round(now.height_m * 1e3),
        *(round(v * 100) for v in now.estimate.velocity_ned_m_s),
        round(_heading_deg(now) * 100) % 36000,
    )


def highres_imu(now: Snapshot) -> Message:
    e = now.estimate
    return mavlink.MAVLink_highres_imu_message(
        now.boot_us,
        *e.acceleration_frd_m_s2,
        *e.rates_frd_rad_s,
        *(0.0,) * 7,
        _IMU_FIELDS_UPDATED,
    )


def altitude(now: Snapshot) -> Message:
    amsl_m, height_m = HOME_AMSL_M + now.height_m, now.height_m
    return mavlink.MAVLink_altitude_message(
        now.boot_us, amsl_m, amsl_m, height_m, height_m, NAN, height_m
    )


def distance_sensor(now: Snapshot) -> Message:
    """The downward range finder that holds the height; says its limits beyond them."""
    least_cm, most_cm = 2, 600
    return mavlink.MAVLink_distance_sensor_message(
        now.boot_ms,
        least_cm,
        most_cm,
        min(most_cm, max(least_cm, round(now.height_m * 100))),
        mavlink.MAV_DISTANCE_SENSOR_ULTRASOUND,
        0,
        mavlink.MAV_SENSOR_ROTATION_PITCH_270,
        255,
    )


def vfr_hud(now: Snapshot) -> Message:
    north_m_s, east_m_s, down_m_s = now.estimate.velocity_ned_m_s
    speed_m_s = math.hypot(north_m_s, east_m_s)
    return mavlink.MAVLink_vfr_hud_message(
        speed_m_s,
        speed_m_s,
        round(_heading_deg(now)) % 360,
        _percent(now.status.thrust_norm, unknown=0),
        HOME_AMSL_M + now.height_m,
        -down_m_s,
    )


def attitude_target(now: Snapshot) -> Message:
    s = now.status
    yaw_rad = s.yaw_setpoint_rad if math.isfinite(s.yaw_setpoint_rad) else now.estimate.yaw_rad
    return mavlink.MAVLink_attitude_target_message(
        now.boot_ms,
        0,
        quaternion_from_euler(s.roll_setpoint_rad, s.pitch_setpoint_rad, yaw_rad),
        0.0,
        0.0,
        s.yaw_rate_setpoint_rad_s,
        s.thrust_norm,
    )


def position_target_local_ned(now: Snapshot) -> Message:
    s = now.status
    return mavlink.MAVLink_position_target_local_ned_message(
        now.boot_ms,
        mavlink.MAV_FRAME_LOCAL_NED,
        0,
        *s.position_setpoint_ned_m,
        *s.velocity_setpoint_ned_m_s,
        NAN,
        NAN,
        NAN,
        s.yaw_setpoint_rad,
        s.yaw_rate_setpoint_rad_s,
    )


def servo_output_raw(now: Snapshot) -> Message:
    pulses_us = (round(1000 + 1000 * motor) for motor in now.status.motors_norm)
    return mavlink.MAVLink_servo_output_raw_message(
        now.boot_us & 0xFFFFFFFF, 0, *pulses_us, 0, 0, 0, 0
    )


def sys_status(now: Snapshot) -> Message:
    s = now.status
    known = _SENSORS_ALWAYS | _SENSORS_WHEN_READY
    healthy = known if now.ready else _SENSORS_ALWAYS
    return mavlink.MAVLink_sys_status_message(
        known,
        known,
        healthy,
        0,
        round(s.battery_voltage_v * 1e3),
        round(s.battery_current_a * 100),
        _percent(s.battery_norm, unknown=-1),
        *(0,) * 6,
    )


def extended_sys_state(now: Snapshot) -> Message:
    return mavlink.MAVLink_extended_sys_state_message(
        mavlink.MAV_VTOL_STATE_UNDEFINED, modes.LANDED_STATES[now.status.landed_state]
    )


def system_time(now: Snapshot) -> Message:
    """No GPS, hence no date."""
    return mavlink.MAVLink_system_time_message(0, now.boot_ms)


def estimator_status(now: Snapshot) -> Message:
    flags = mavlink.ESTIMATOR_ATTITUDE | (_ESTIMATES_WHEN_READY if now.ready else 0)
    return mavlink.MAVLink_estimator_status_message(now.boot_us, flags, *(0.0,) * 8)


def home_position(now: Snapshot) -> Message:
    return mavlink.MAVLink_home_position_message(
        round(HOME_LATITUDE_DEG * 1e7),
        round(HOME_LONGITUDE_DEG * 1e7),
        round(HOME_AMSL_M * 1e3),
        0.0,
        0.0,
        0.0,
        (1.0, 0.0, 0.0, 0.0),
        NAN,
        NAN,
        NAN,
        now.boot_us,
    )


def battery_status(now: Snapshot) -> Message:
    s = now.status
    millivolts = min(round(s.battery_voltage_v * 1e3), _UNKNOWN_UINT16)
    return mavlink.MAVLink_battery_status_message(
        0,
        mavlink.MAV_BATTERY_FUNCTION_ALL,
        mavlink.MAV_BATTERY_TYPE_LIPO,
        0x7FFF,
        [millivolts] + [_UNKNOWN_UINT16] * 9,
        round(s.battery_current_a * 100),
        -1,
        -1,
        _percent(s.battery_norm, unknown=-1),
    )


def gps_raw_int(now: Snapshot) -> Message:
    no_fix = mavlink.GPS_FIX_TYPE_NO_FIX
    unknown = (_UNKNOWN_UINT16,) * 4
    return mavlink.MAVLink_gps_raw_int_message(now.boot_us, no_fix, 0, 0, 0, *unknown, 0)


def autopilot_version(_now: Snapshot) -> Message:
    nothing = [0] * 8
    return mavlink.MAVLink_autopilot_version_message(
        _CAPABILITIES, _PX4_VERSION, _PX4_VERSION, 0, 0, nothing, nothing, nothing, 0, 0, 1
    )


def _heading_deg(now: Snapshot) -> float:
    return math.degrees(now.estimate.yaw_rad) % 360.0


def _percent(share_norm: float, unknown: int) -> int:
    return round(100.0 * share_norm) if math.isfinite(share_norm) else unknown
