"""Which message goes out when: PX4's rates on its links, in simulated time."""

from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

from pymavlink.dialects.v20 import common as mavlink
from pymavlink.dialects.v20 import development

from sitl.mavlink import motion, sensing, state
from sitl.mavlink.link_url import Profile
from sitl.mavlink.snapshot import Message, Snapshot


class Stream(NamedTuple):
    """Rates at start-up; 0 sends the message on request only."""

    builder: Callable[[Snapshot], Message | None]
    """None while there is nothing to send."""
    onboard_hz: float
    gcs_hz: float

    def rate_hz(self, profile: Profile) -> float:
        return self.onboard_hz if profile is Profile.ONBOARD else self.gcs_hz


# Onboard: measured on PX4 v1.17. GCS: PX4's mavlink_main.cpp, mode "normal".
STREAMS: Final[Mapping[int, Stream]] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: Stream(state.heartbeat, 1.0, 1.0),
    mavlink.MAVLINK_MSG_ID_ATTITUDE: Stream(motion.attitude, 100.0, 15.0),
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: Stream(motion.attitude_quaternion, 50.0, 10.0),
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: Stream(motion.global_position_int, 50.0, 5.0),
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: Stream(sensing.highres_imu, 50.0, 0.0),
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: Stream(motion.local_position_ned, 30.0, 1.0),
    mavlink.MAVLINK_MSG_ID_ODOMETRY: Stream(sensing.odometry, 30.0, 0.0),
    mavlink.MAVLINK_MSG_ID_TIMESYNC: Stream(state.timesync, 10.0, 0.0),
    mavlink.MAVLINK_MSG_ID_ALTITUDE: Stream(motion.altitude, 10.0, 1.0),
    mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: Stream(sensing.distance_sensor, 10.0, 0.5),
    mavlink.MAVLINK_MSG_ID_VFR_HUD: Stream(motion.vfr_hud, 10.0, 4.0),
    mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: Stream(motion.attitude_target, 10.0, 2.0),
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: Stream(
        motion.position_target_local_ned, 10.0, 1.5
    ),
    mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: Stream(motion.servo_output_raw, 10.0, 1.0),
    mavlink.MAVLINK_MSG_ID_OPTICAL_FLOW_RAD: Stream(sensing.optical_flow_rad, 10.0, 1.0),
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: Stream(sensing.gps_raw_int, 8.0, 5.0),
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: Stream(state.sys_status, 5.0, 1.0),
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: Stream(state.extended_sys_state, 5.0, 1.0),
    mavlink.MAVLINK_MSG_ID_ORBIT_EXECUTION_STATUS: Stream(state.orbit_execution_status, 2.0, 2.0),
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: Stream(state.system_time, 1.0, 0.0),
    mavlink.MAVLINK_MSG_ID_PING: Stream(state.ping, 1.0, 0.1),
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: Stream(sensing.estimator_status, 1.0, 0.5),
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE: Stream(sensing.scaled_pressure, 1.0, 1.0),
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: Stream(state.mission_current, 1.0, 1.0),
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: Stream(state.home_position, 0.5, 0.5),
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: Stream(state.battery_status, 0.5, 0.5),
    development.MAVLINK_MSG_ID_CURRENT_MODE: Stream(state.current_mode, 0.5, 0.5),
    mavlink.MAVLINK_MSG_ID_VIBRATION: Stream(state.vibration, 0.5, 0.1),
    mavlink.MAVLINK_MSG_ID_SCALED_IMU: Stream(sensing.scaled_imu, 0.0, 0.0),
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: Stream(state.gps_global_origin, 0.0, 0.0),
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: Stream(state.autopilot_version, 0.0, 0.0),
}

_CLOCK_TOLERANCE_S = 1e-6
"""Steps are added up in floating point; a message due now must not slip to the next step."""


class Schedule:
    """The periods of one client's messages; only heartbeats until ``start``."""

    def __init__(self, profile: Profile, time_s: float) -> None:
        self._profile = profile
        self._period_s: dict[int, float] = {}
        self._due_s: dict[int, float] = {}
        self._chosen: set[int] = set()
        self._started = False
        self._soonest_s = float("inf")
        self.set_interval(mavlink.MAVLINK_MSG_ID_HEARTBEAT, 0.0, time_s)

    def start(self, time_s: float) -> None:
        """All streams of the profile whose rates were not asked for yet."""
        if not self._started:
            self._started = True
            for message_id in STREAMS.keys() - self._chosen:
                self._set_period(message_id, self._default_s(message_id), time_s)

    def set_interval(self, message_id: int, interval_us: float, time_s: float) -> bool:
        """SET_MESSAGE_INTERVAL: 0 means PX4's rate, negative switches off; False if unknown."""
        if message_id not in STREAMS or not interval_us < float("inf"):
            return False
        self._chosen.add(message_id)
        period_s = self._default_s(message_id) if interval_us == 0.0 else interval_us * 1e-6
        self._set_period(message_id, period_s, time_s)
        return True

    def interval_us(self, message_id: int) -> int:
        """MESSAGE_INTERVAL's figure: -1 when it is not sent, 0 when there is no such message."""
        if message_id not in STREAMS:
            return 0
        sent = message_id in self._due_s
        return round(self._period_s[message_id] * 1e6) if sent else -1

    def due(self, time_s: float) -> list[int]:
        """The ids to send now; each is then due one period later."""
        now_s = time_s + _CLOCK_TOLERANCE_S
        if now_s < self._soonest_s:
            return []
        due = [message_id for message_id, due_s in self._due_s.items() if due_s <= now_s]
        for message_id in due:
            next_s = self._due_s[message_id] + self._period_s[message_id]
            self._due_s[message_id] = max(next_s, time_s)  # no burst to catch up
        self._soonest_s = min(self._due_s.values())
        return due

    def _default_s(self, message_id: int) -> float:
        rate_hz = STREAMS[message_id].rate_hz(self._profile)
        return 1.0 / rate_hz if rate_hz > 0.0 else -1.0

    def _set_period(self, message_id: int, period_s: float, time_s: float) -> None:
        """Negative: not sent."""
        self._due_s.pop(message_id, None)
        if period_s > 0.0:
            self._period_s[message_id], self._due_s[message_id] = period_s, time_s
        self._soonest_s = min(self._due_s.values(), default=float("inf"))
