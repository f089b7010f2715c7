"""Sensors and estimate as MAVLink messages; a sensor that is off sends none, as in PX4."""

import math
from typing import Final

from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.frames import Vector3, quaternion_from_euler
from companion.kernel.messages import NAN
from sitl.mavlink.snapshot import Message, Snapshot
from sitl.sensors.nature import height_amsl_m
from sitl.sensors.suite import FLOW_PERIOD_S

_IMU_FIELDS: Final = 0x3F  # three accelerations, three rates
_FIELD_FIELDS: Final = 0x1C0
_AIR_FIELDS: Final = 0x1A00  # pressure, its altitude, temperature
_ZERO_C_K: Final = 273.15
_UNKNOWN_UINT16: Final = 0xFFFF
_FOV_DEG: Final = 42
_MILLIG: Final = 1000.0 / 9.80665
_VARIANCES_AT: Final = (0, 6, 11, 15, 18, 20)  # in the upper triangle of a 6 x 6 matrix
_ALWAYS: Final = mavlink.ESTIMATOR_ATTITUDE
_LEVEL: Final = mavlink.ESTIMATOR_VELOCITY_HORIZ | mavlink.ESTIMATOR_POS_HORIZ_REL
_HEIGHT: Final = (
    mavlink.ESTIMATOR_VELOCITY_VERT
    | mavlink.ESTIMATOR_POS_VERT_ABS
    | mavlink.ESTIMATOR_POS_VERT_AGL
)


def highres_imu(now: Snapshot) -> Message:
    """Accelerations and rates are those that the estimate stands on."""
    e, air, field = now.estimate, now.sensors.air(), now.sensors.field_frd_gauss()
    fields = _IMU_FIELDS | (_FIELD_FIELDS if field else 0) | (_AIR_FIELDS if air else 0)
    return mavlink.MAVLink_highres_imu_message(
        now.boot_us,
        *e.acceleration_frd_m_s2,
        *e.rates_frd_rad_s,
        *(field or (0.0, 0.0, 0.0)),
        air.pressure_pa * 1e-2 if air else 0.0,
        0.0,
        height_amsl_m(air.pressure_pa) if air else 0.0,
        air.temperature_k - _ZERO_C_K if air else 0.0,
        fields,
    )


def scaled_imu(now: Snapshot) -> Message:
    e, air, field = now.estimate, now.sensors.air(), now.sensors.field_frd_gauss()
    return mavlink.MAVLink_scaled_imu_message(
        now.boot_ms,
        *_int16(e.acceleration_frd_m_s2, _MILLIG),
        *_int16(e.rates_frd_rad_s, 1000.0),
        *_int16(field or (0.0, 0.0, 0.0), 1000.0),
        round((air.temperature_k - _ZERO_C_K) * 100) if air else 0,
    )


def scaled_pressure(now: Snapshot) -> Message | None:
    air = now.sensors.air()
    if air is None:
        return None
    return mavlink.MAVLink_scaled_pressure_message(
        now.boot_ms,
        air.pressure_pa * 1e-2,
        0.0,
        round((air.temperature_k - _ZERO_C_K) * 100),
    )


def distance_sensor(now: Snapshot) -> Message | None:
    """The downward range finder that holds the height; says its limits beyond them."""
    distance_m = now.sensors.range_m()
    if distance_m is None:
        return None
    metres = (*now.sensors.range_limits_m, distance_m)
    return mavlink.MAVLink_distance_sensor_message(
        now.boot_ms,
        *(min(_UNKNOWN_UINT16, round(value_m * 100)) for value_m in metres),
        mavlink.MAV_DISTANCE_SENSOR_ULTRASOUND,
        0,
        mavlink.MAV_SENSOR_ROTATION_PITCH_270,
        255,
        math.radians(_FOV_DEG),
        math.radians(_FOV_DEG),
    )


def optical_flow_rad(now: Snapshot) -> Message | None:
    flow = now.sensors.flow()
    if flow is None:
        return None
    return mavlink.MAVLink_optical_flow_rad_message(
        now.boot_us,
        0,
        round(FLOW_PERIOD_S * 1e6),
        *flow.turned_rad,
        *flow.gyro_rad,
        0,
        round(flow.quality_percent * 2.55),
        0,
        flow.distance_m,
    )


def gps_raw_int(now: Snapshot) -> Message:
    """Satellites are seen only with SYS_HAS_GPS."""
    fix = now.sensors.fix()
    if fix is None:
        unknown = (_UNKNOWN_UINT16,) * 4
        no_fix = mavlink.GPS_FIX_TYPE_NO_FIX
        return mavlink.MAVLink_gps_raw_int_message(now.boot_us, no_fix, 0, 0, 0, *unknown, 0)
    latitude_deg, longitude_deg = now.origin.degrees(fix.position_ned_m)
    v_north, v_east, _ = fix.velocity_ned_m_s
    course_deg = math.degrees(math.atan2(v_east, v_north)) % 360.0
    return mavlink.MAVLink_gps_raw_int_message(
        now.boot_us,
        mavlink.GPS_FIX_TYPE_3D_FIX,
        round(latitude_deg * 1e7),
        round(longitude_deg * 1e7),
        round((now.origin.amsl_m - fix.position_ned_m[2]) * 1e3),
        90,  # dilution of precision, in hundredths: an open sky
        90,
        round(math.hypot(v_north, v_east) * 100),
        round(course_deg * 100) % 36000,
        fix.satellites,
    )


def estimator_status(now: Snapshot) -> Message:
    """As the estimator judges itself; the vehicle is still again before a flight if not ready."""
    quality, flags = now.quality, _ALWAYS
    if now.ready or now.status.armed:
        flags |= _LEVEL if quality.level_valid else mavlink.ESTIMATOR_CONST_POS_MODE
        flags |= _HEIGHT if quality.height_valid else 0
        flags |= mavlink.ESTIMATOR_POS_HORIZ_ABS if quality.absolute else 0
    ratios = quality.ratios
    return mavlink.MAVLink_estimator_status_message(
        now.boot_us,
        flags,
        math.sqrt(ratios.velocity),
        math.sqrt(ratios.level),
        math.sqrt(ratios.down),
        0.0,
        0.0,
        0.0,
        quality.level_deviation_m,
        quality.height_deviation_m,
    )


def odometry(now: Snapshot) -> Message:
    """Velocity in NED, as PX4's EKF2 publishes it; child_frame_id says so."""
    e, q = now.estimate, now.quality
    level, tilt, speed = (
        deviation * deviation
        for deviation in (q.level_deviation_m, q.tilt_deviation_rad, q.velocity_deviation_m_s)
    )
    height, yaw = q.height_deviation_m**2, q.yaw_deviation_rad**2
    return mavlink.MAVLink_odometry_message(
        now.boot_us,
        mavlink.MAV_FRAME_LOCAL_NED,
        mavlink.MAV_FRAME_LOCAL_NED,
        *e.position_ned_m,
        quaternion_from_euler(e.roll_rad, e.pitch_rad, e.yaw_rad),
        *e.velocity_ned_m_s,
        *e.rates_frd_rad_s,
        _covariance(level, level, height, tilt, tilt, yaw),
        _covariance(speed, speed, speed, NAN, NAN, NAN),
        q.resets % 256,
        mavlink.MAV_ESTIMATOR_TYPE_AUTOPILOT,
        100 if now.ready and q.level_valid else 0,
    )


def _covariance(*variances: float) -> list[float]:
    """Only the diagonal is known."""
    covariance = [NAN] * 21
    for place, variance in zip(_VARIANCES_AT, variances, strict=True):
        covariance[place] = variance
    return covariance


def _int16(vector: Vector3, scale: float) -> tuple[int, ...]:
    return tuple(max(-32768, min(32767, round(value * scale))) for value in vector)
