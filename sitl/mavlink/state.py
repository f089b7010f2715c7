"""State as MAVLink messages: modes, health, power, and what stands in for GPS."""

from pymavlink.dialects.v20 import common as mavlink
from pymavlink.dialects.v20 import development

from companion.kernel.frames import quaternion_from_euler
from companion.kernel.messages import NAN
from sitl.failures import Unit
from sitl.mavlink import modes
from sitl.mavlink.snapshot import Message, Snapshot, percent

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
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)
_SENSORS_ALWAYS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
)
_SENSORS_THAT_FAIL = {
    Unit.MAGNETOMETER: mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG,
    Unit.BAROMETER: mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE,
    Unit.OPTICAL_FLOW: mavlink.MAV_SYS_STATUS_SENSOR_OPTICAL_FLOW,
    Unit.RANGE_FINDER: mavlink.MAV_SYS_STATUS_SENSOR_LASER_POSITION,
    Unit.BATTERY: mavlink.MAV_SYS_STATUS_SENSOR_BATTERY,
}
_WHEN_READY = mavlink.MAV_SYS_STATUS_AHRS | mavlink.MAV_SYS_STATUS_PREARM_CHECK
_UNKNOWN_UINT16 = 0xFFFF


def heartbeat(now: Snapshot) -> Message:
    status = now.status
    return mavlink.MAVLink_heartbeat_message(
        int(now.parameters["MAV_TYPE"]),
        mavlink.MAV_AUTOPILOT_PX4,
        modes.base_mode(status.mode, status.armed),
        modes.custom_mode(status.mode),
        modes.system_status(status.ready_to_arm, status.armed, status.failsafe),
        3,
    )


def sys_status(now: Snapshot) -> Message:
    s = now.status
    known, healthy = _WHEN_READY | _SENSORS_ALWAYS, _SENSORS_ALWAYS
    for unit, bit in _SENSORS_THAT_FAIL.items():
        known |= bit
        healthy |= bit if now.sensors.works(unit) else 0
    if now.parameters["SYS_HAS_GPS"]:
        known |= mavlink.MAV_SYS_STATUS_SENSOR_GPS
        healthy |= mavlink.MAV_SYS_STATUS_SENSOR_GPS if now.sensors.fix() else 0
    if now.quality.absolute:
        known |= mavlink.MAV_SYS_STATUS_SENSOR_VISION_POSITION
        healthy |= mavlink.MAV_SYS_STATUS_SENSOR_VISION_POSITION
    healthy |= _WHEN_READY if now.ready and now.quality.level_valid else 0
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
    """No GPS, hence no date. The time since boot is the one that TIMESYNC tells."""
    return mavlink.MAVLink_system_time_message(0, round(now.time_s * 1e3))


def timesync(now: Snapshot) -> Message:
    """A question; what is answered stays unused, for no time stamp of a client is."""
    return mavlink.MAVLink_timesync_message(0, now.boot_ns)


def ping(now: Snapshot) -> Message:
    """To everybody; numbered by the seconds since boot."""
    return mavlink.MAVLink_ping_message(round(now.time_s * 1e6), round(now.time_s), 0, 0)


def current_mode(now: Snapshot) -> Message:
    status = now.status
    return development.MAVLink_current_mode_message(
        modes.STANDARD_MODES.get(status.mode, modes.NON_STANDARD_MODE),
        modes.custom_mode(status.mode),
        modes.custom_mode(status.intended_mode),
    )


def vibration(now: Snapshot) -> Message:
    """As PX4: z is of the accelerometer, y of the gyroscope, x is of none any more."""
    status = now.status
    return mavlink.MAVLink_vibration_message(
        now.boot_us, 0.0, status.gyro_vibration_rad_s, status.acceleration_vibration_m_s2, 0, 0, 0
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
        percent(s.battery_norm, unknown=-1),
    )


def mission_current(now: Snapshot) -> Message:
    return mavlink.MAVLink_mission_current_message(*now.status.mission)


def orbit_execution_status(now: Snapshot) -> Message | None:
    """None while none is flown."""
    orbit = now.status.orbit
    if orbit is None:
        return None
    latitude_deg, longitude_deg = now.origin.degrees(orbit.centre_ned_m)
    return mavlink.MAVLink_orbit_execution_status_message(
        now.boot_us,
        orbit.radius_m,
        mavlink.MAV_FRAME_GLOBAL,
        round(latitude_deg * 1e7),
        round(longitude_deg * 1e7),
        now.origin.amsl_m - orbit.centre_ned_m[2],
    )


def home_position(now: Snapshot) -> Message:
    home_ned_m = now.status.home_ned_m
    latitude_deg, longitude_deg = now.origin.degrees(home_ned_m)
    return mavlink.MAVLink_home_position_message(
        round(latitude_deg * 1e7),
        round(longitude_deg * 1e7),
        round((now.origin.amsl_m - home_ned_m[2]) * 1e3),
        *home_ned_m,
        quaternion_from_euler(0.0, 0.0, now.status.home_yaw_rad),
        NAN,
        NAN,
        NAN,
        now.boot_us,
    )


def gps_global_origin(now: Snapshot) -> Message:
    """Where local (0, 0, 0) is."""
    return mavlink.MAVLink_gps_global_origin_message(
        round(now.origin.latitude_deg * 1e7),
        round(now.origin.longitude_deg * 1e7),
        round(now.origin.amsl_m * 1e3),
        now.boot_us,
    )


def autopilot_version(_now: Snapshot) -> Message:
    nothing = [0] * 8
    return mavlink.MAVLink_autopilot_version_message(
        _CAPABILITIES, _PX4_VERSION, _PX4_VERSION, 0, 0, nothing, nothing, nothing, 0, 0, 1
    )
