"""Which message goes out when: PX4's rates on its onboard link, in simulated time."""

from collections.abc import Mapping
from typing import NamedTuple

from sitl.mavlink import messages
from sitl.mavlink.messages import Builder, mavlink


class Stream(NamedTuple):
    builder: Builder
    rate_hz: float
    """At start-up; 0 sends it on request only."""


STREAMS: Mapping[int, Stream] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: Stream(messages.heartbeat, 1.0),
    mavlink.MAVLINK_MSG_ID_ATTITUDE: Stream(messages.attitude, 100.0),
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: Stream(messages.attitude_quaternion, 50.0),
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: Stream(messages.global_position_int, 50.0),
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: Stream(messages.highres_imu, 50.0),
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: Stream(messages.local_position_ned, 30.0),
    mavlink.MAVLINK_MSG_ID_ODOMETRY: Stream(messages.odometry, 30.0),
    mavlink.MAVLINK_MSG_ID_ALTITUDE: Stream(messages.altitude, 10.0),
    mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: Stream(messages.distance_sensor, 10.0),
    mavlink.MAVLINK_MSG_ID_VFR_HUD: Stream(messages.vfr_hud, 10.0),
    mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: Stream(messages.attitude_target, 10.0),
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: Stream(
        messages.position_target_local_ned, 10.0
    ),
    mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: Stream(messages.servo_output_raw, 10.0),
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: Stream(messages.gps_raw_int, 8.0),
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: Stream(messages.sys_status, 5.0),
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: Stream(messages.extended_sys_state, 5.0),
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: Stream(messages.system_time, 1.0),
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: Stream(messages.estimator_status, 1.0),
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: Stream(messages.home_position, 0.5),
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: Stream(messages.battery_status, 0.5),
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: Stream(messages.autopilot_version, 0.0),
}

_CLOCK_TOLERANCE_S = 1e-6
"""Steps are added up in floating point; a message due now must not slip to the next step."""


class Schedule:
    """The periods of one link's messages."""

    def __init__(self, time_s: float) -> None:
        self._period_s: dict[int, float] = {}
        self._due_s: dict[int, float] = {}
        for message_id in STREAMS:
            self.set_interval(message_id, 0.0, time_s)

    def set_interval(self, message_id: int, interval_us: float, time_s: float) -> bool:
        """SET_MESSAGE_INTERVAL: 0 means PX4's rate, negative switches off; False if unknown."""
        stream = STREAMS.get(message_id)
        if stream is None:
            return False
        self._due_s.pop(message_id, None)
        if interval_us > 0.0:
            self._period_s[message_id], self._due_s[message_id] = interval_us * 1e-6, time_s
        elif interval_us == 0.0 and stream.rate_hz > 0.0:
            self._period_s[message_id], self._due_s[message_id] = 1.0 / stream.rate_hz, time_s
        self._soonest_s = min(self._due_s.values(), default=float("inf"))
        return True

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
