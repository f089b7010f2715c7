"""State as MAVLink messages: modes, health, power, and what stands in for GPS."""

from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.messages import NAN
from sitl.mavlink import modes
from sitl.mavlink.snapshot import (
    HOME_AMSL_M,
    HOME_LATITUDE_DEG,
    HOME_LONGITUDE_DEG,
    Message,
    Snapshot,
    percent,
)

_PX4_VERSION = 1 << 24 | 17 << 16 | 0 << 8 | 255
_CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FLOAT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
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
_UNKNOWN_UINT16 = 0xFFFF


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
        percent(s.battery_norm, unknown=-1),
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
        percent(s.battery_norm, unknown=-1),
    )


def mission_current(now: Snapshot) -> Message:
    return mavlink.MAVLink_mission_current_message(*now.status.mission)


def gps_raw_int(now: Snapshot) -> Message:
    no_fix = mavlink.GPS_FIX_TYPE_NO_FIX
    unknown = (_UNKNOWN_UINT16,) * 4
    return mavlink.MAVLink_gps_raw_int_message(now.boot_us, no_fix, 0, 0, 0, *unknown, 0)


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


def autopilot_version(_now: Snapshot) -> Message:
    nothing = [0] * 8
    return mavlink.MAVLink_autopilot_version_message(
        _CAPABILITIES, _PX4_VERSION, _PX4_VERSION, 0, 0, nothing, nothing, nothing, 0, 0, 1
    )
