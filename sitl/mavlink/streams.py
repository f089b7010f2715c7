"""Which message goes out when: PX4's rates on its onboard link, in simulated time."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

from pymavlink.dialects.v20 import common as mavlink

from sitl.mavlink import motion, state
from sitl.mavlink.snapshot import Message, Snapshot


class Stream(NamedTuple):
    builder: Callable[[Snapshot], Message]
    rate_hz: float
    """At start-up; 0 sends it on request only."""


STREAMS: Mapping[int, Stream] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: Stream(state.heartbeat, 1.0),
    mavlink.MAVLINK_MSG_ID_ATTITUDE: Stream(motion.attitude, 100.0),
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: Stream(motion.attitude_quaternion, 50.0),
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: Stream(motion.global_position_int, 50.0),
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: Stream(motion.highres_imu, 50.0),
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: Stream(motion.local_position_ned, 30.0),
    mavlink.MAVLINK_MSG_ID_ODOMETRY: Stream(motion.odometry, 30.0),
    mavlink.MAVLINK_MSG_ID_ALTITUDE: Stream(motion.altitude, 10.0),
    mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: Stream(motion.distance_sensor, 10.0),
    mavlink.MAVLINK_MSG_ID_VFR_HUD: Stream(motion.vfr_hud, 10.0),
    mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: Stream(motion.attitude_target, 10.0),
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: Stream(
        motion.position_target_local_ned, 10.0
    ),
    mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: Stream(motion.servo_output_raw, 10.0),
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: Stream(state.gps_raw_int, 8.0),
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: Stream(state.sys_status, 5.0),
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: Stream(state.extended_sys_state, 5.0),
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: Stream(state.system_time, 1.0),
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: Stream(state.estimator_status, 1.0),
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: Stream(state.mission_current, 1.0),
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: Stream(state.home_position, 0.5),
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: Stream(state.battery_status, 0.5),
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: Stream(state.autopilot_version, 0.0),
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
