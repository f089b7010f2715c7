"""Motion as MAVLink messages: where the vehicle is, how it moves, what it aims at."""

import math

from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.frames import quaternion_from_euler
from companion.kernel.messages import NAN
from sitl.mavlink.snapshot import Message, Snapshot, percent

_IMU_FIELDS_UPDATED = 0x3F  # three accelerations, three rates
_UNKNOWN_COVARIANCE = [NAN] * 21


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
    latitude_deg, longitude_deg = now.origin.degrees(now.estimate.position_ned_m)
    return mavlink.MAVLink_global_position_int_message(
        now.boot_ms,
        round(latitude_deg * 1e7),
        round(longitude_deg * 1e7),
        round(now.amsl_m * 1e3),
        round(now.height_over_home_m * 1e3),
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
    amsl_m, height_m = now.amsl_m, now.height_m
    return mavlink.MAVLink_altitude_message(
        now.boot_us, amsl_m, amsl_m, height_m, now.height_over_home_m, NAN, height_m
    )


def distance_sensor(now: Snapshot) -> Message:
    """The downward range finder that holds the height; says its limits beyond them."""
    least_m = now.parameters["SIH_DISTSNSR_MIN"]
    most_m = max(least_m, now.parameters["SIH_DISTSNSR_MAX"])
    given_m = now.parameters["SIH_DISTSNSR_OVR"]
    distance_m = given_m if given_m >= 0.0 else min(most_m, max(least_m, now.height_m))
    return mavlink.MAVLink_distance_sensor_message(
        now.boot_ms,
        *(min(0xFFFF, round(value_m * 100)) for value_m in (least_m, most_m, distance_m)),
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
        percent(now.status.thrust_norm, unknown=0),
        now.amsl_m,
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


def _heading_deg(now: Snapshot) -> float:
    return math.degrees(now.estimate.yaw_rad) % 360.0
