"""Motion as MAVLink messages: where the vehicle is, how it moves, what it aims at."""

import math

from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.frames import quaternion_from_euler
from companion.kernel.messages import NAN
from sitl.mavlink.snapshot import Message, Snapshot, percent


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


def altitude(now: Snapshot) -> Message:
    amsl_m, height_m = now.amsl_m, now.height_m
    return mavlink.MAVLink_altitude_message(
        now.boot_us, amsl_m, amsl_m, height_m, now.height_over_home_m, NAN, height_m
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
