"""The vehicle's side of its links: what it answers, and what it sends unasked."""

import logging
from collections.abc import Callable, Mapping, Sequence

from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilot.interface import Ack, AutopilotPort, StatusText
from sitl.mavlink import commands, framing
from sitl.mavlink.links import UdpLink
from sitl.mavlink.missions import MissionProtocol
from sitl.mavlink.parameters import requested_values
from sitl.mavlink.setpoints import FRAMES, attitude_setpoint, manual_input, offboard_setpoint
from sitl.mavlink.snapshot import Snapshot
from sitl.mavlink.streams import STREAMS, Schedule
from sitl.mavlink.tlog import TelemetryLog

logger = logging.getLogger(__name__)

MAX_OUTGOING_BYTES = 1400
"""Messages of one moment share datagrams up to what an Ethernet frame carries."""
MAX_DATAGRAMS_PER_POLL = 64
"""So that a flooding client cannot stop the world."""


class Channel:
    """One link with its sequence numbers, rates and waiting frames."""

    def __init__(self, link: UdpLink, time_s: float, log: TelemetryLog | None) -> None:
        self.link = link
        self.schedule = Schedule(time_s)
        self.log = log
        self.has_ground_station = False
        self._sequence = 0
        self._waiting = bytearray()

    def put(self, frame: framing.Frame, time_s: float) -> None:
        packed = frame.numbered(self._sequence)
        self._sequence = (self._sequence + 1) % 256
        if self.log is not None:
            self.log.write(time_s, packed)
        if len(self._waiting) + len(packed) > MAX_OUTGOING_BYTES:
            self.flush()
        self._waiting += packed

    def flush(self) -> None:
        if self._waiting:
            self.link.send(bytes(self._waiting))
            self._waiting.clear()


class MavlinkServer:
    """Serves one autopilot on several links; call ``poll`` and ``update`` between two steps."""

    def __init__(
        self,
        autopilot: AutopilotPort,
        links: Sequence[UdpLink],
        log: TelemetryLog | None = None,
        speed: float = 1.0,
    ) -> None:
        """``log`` keeps all that the first link sends and receives; closed by ``close``.

        ``speed`` is the world's: clients time heartbeats on their own clocks, so a world slower
        than real time sends more of them.
        """
        self._autopilot = autopilot
        self._log = log
        time_s = autopilot.estimate.time_s
        self.channels = [
            Channel(link, time_s, log if number == 0 else None) for number, link in enumerate(links)
        ]
        for channel in self.channels:
            channel.schedule.set_interval(
                mavlink.MAVLINK_MSG_ID_HEARTBEAT, 1e6 * min(1.0, speed), time_s
            )
        self._missions = MissionProtocol(autopilot)
        self._unknown_frames: set[int] = set()
        self._handlers: Mapping[int, Callable[[Channel, mavlink.MAVLink_message], None]] = {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: self._on_heartbeat,
            mavlink.MAVLINK_MSG_ID_COMMAND_LONG: self._on_command,
            mavlink.MAVLINK_MSG_ID_COMMAND_INT: self._on_command,
            mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: self._on_setpoint,
            mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET: self._on_attitude_setpoint,
            mavlink.MAVLINK_MSG_ID_MANUAL_CONTROL: self._on_manual_control,
            mavlink.MAVLINK_MSG_ID_TIMESYNC: self._on_timesync,
            mavlink.MAVLINK_MSG_ID_PING: self._on_ping,
            mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ: self._on_parameter,
            mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: self._on_parameter,
            mavlink.MAVLINK_MSG_ID_PARAM_SET: self._on_parameter,
            **dict.fromkeys(self._missions.handlers, self._on_mission),
        }

    def poll(self) -> None:
        """Takes and answers all that has arrived."""
        for channel in self.channels:
            for _ in range(MAX_DATAGRAMS_PER_POLL):
                datagram = channel.link.receive()
                if datagram is None:
                    break
                for frame in framing.split(datagram):
                    self._take(channel, frame)
            channel.flush()

    def update(self, time_s: float) -> None:
        """Sends what is due at this time of the world; a message is encoded once for all links."""
        frames: dict[int, framing.Frame] = {}
        now: Snapshot | None = None
        for channel in self.channels:
            for message_id in channel.schedule.due(time_s):
                if message_id not in frames:
                    now = now or self._snapshot()
                    frames[message_id] = framing.encode(STREAMS[message_id].builder(now))
                channel.put(frames[message_id], time_s)
        for message in self._missions.update():
            for channel in self.channels:
                self._send(channel, message)
        for text in self._autopilot.drain_status_texts():
            self._put_status_text(text, time_s)
        for channel in self.channels:
            channel.flush()

    def close(self) -> None:
        for channel in self.channels:
            channel.link.close()
        if self._log is not None:
            self._log.close()

    def _snapshot(self) -> Snapshot:
        return Snapshot(self._autopilot.estimate, self._autopilot.status)

    def _time_s(self) -> float:
        return self._autopilot.estimate.time_s

    def _take(self, channel: Channel, frame: bytes) -> None:
        message = framing.decode(frame)
        if message is None:
            return
        if channel.log is not None:
            channel.log.write(self._time_s(), frame)
        handler = self._handlers.get(message.get_msgId())
        if handler is not None and _is_for_us(message):
            handler(channel, message)

    def _send(self, channel: Channel, message: mavlink.MAVLink_message) -> None:
        channel.put(framing.encode(message), self._time_s())

    def _put_status_text(self, status: StatusText, time_s: float) -> None:
        """As PX4: only to links on which a ground station was heard."""
        logger.info("autopilot: %s", status.text)
        text = status.text.encode("ascii", "replace")[:50]
        frame = framing.encode(mavlink.MAVLink_statustext_message(int(status.severity), text))
        for channel in self.channels:
            if channel.has_ground_station:
                channel.put(frame, time_s)

    def _on_heartbeat(self, channel: Channel, message: mavlink.MAVLink_message) -> None:
        if message.type == mavlink.MAV_TYPE_GCS:
            channel.has_ground_station = True
            self._autopilot.hear_ground_station()

    def _on_command(self, channel: Channel, message: mavlink.MAVLink_message) -> None:
        parameters = commands.parameters_of(message)
        if message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            known = channel.schedule.set_interval(int(parameters[0]), parameters[1], self._time_s())
            self._acknowledge(channel, message, Ack.ACCEPTED if known else Ack.DENIED)
        elif message.command == mavlink.MAV_CMD_REQUEST_MESSAGE:
            self._on_request_message(channel, message, int(parameters[0]))
        else:
            if message.command == mavlink.MAV_CMD_DO_SET_MODE:
                # PX4's receiver accepts at once; its commander's verdict follows as a second one.
                self._acknowledge(channel, message, Ack.ACCEPTED)
            ack = commands.execute(self._autopilot, message.command, parameters)
            self._acknowledge(channel, message, ack)

    def _on_request_message(
        self, channel: Channel, message: mavlink.MAVLink_message, message_id: int
    ) -> None:
        stream = STREAMS.get(message_id)
        self._acknowledge(channel, message, Ack.ACCEPTED if stream else Ack.DENIED)
        if stream is not None:
            self._send(channel, stream.builder(self._snapshot()))

    def _acknowledge(self, channel: Channel, message: mavlink.MAVLink_message, ack: Ack) -> None:
        sender = message.get_srcSystem(), message.get_srcComponent()
        self._send(
            channel, mavlink.MAVLink_command_ack_message(message.command, int(ack), 0, 0, *sender)
        )

    def _on_setpoint(self, _: Channel, message: mavlink.MAVLink_message) -> None:
        setpoint = offboard_setpoint(message, self._autopilot.estimate)
        if setpoint is not None:
            self._autopilot.set_offboard_setpoint(setpoint)
        elif message.coordinate_frame not in self._unknown_frames:
            self._unknown_frames.add(message.coordinate_frame)
            logger.warning(
                "setpoints in MAV_FRAME %d are ignored; known frames: %s",
                message.coordinate_frame,
                ", ".join(map(str, sorted(FRAMES))),
            )

    def _on_attitude_setpoint(self, _: Channel, message: mavlink.MAVLink_message) -> None:
        self._autopilot.set_offboard_setpoint(attitude_setpoint(message))

    def _on_manual_control(self, _: Channel, message: mavlink.MAVLink_message) -> None:
        if message.target in {0, framing.SYSTEM_ID}:
            self._autopilot.set_manual_input(manual_input(message))

    def _on_timesync(self, channel: Channel, message: mavlink.MAVLink_message) -> None:
        if message.tc1 == 0:  # a question; anything else answers one
            now_ns = round(self._time_s() * 1e9)
            self._send(channel, mavlink.MAVLink_timesync_message(now_ns, message.ts1))

    def _on_ping(self, channel: Channel, message: mavlink.MAVLink_message) -> None:
        if message.target_system == 0 and message.target_component == 0:
            sender = message.get_srcSystem(), message.get_srcComponent()
            self._send(
                channel, mavlink.MAVLink_ping_message(message.time_usec, message.seq, *sender)
            )

    def _on_parameter(self, channel: Channel, message: mavlink.MAVLink_message) -> None:
        for answer in requested_values(self._autopilot, message):
            self._send(channel, answer)

    def _on_mission(self, channel: Channel, message: mavlink.MAVLink_message) -> None:
        handler = self._missions.handlers[message.get_msgId()]
        handler(message, lambda answer: self._send(channel, answer))


def _is_for_us(message: mavlink.MAVLink_message) -> bool:
    return getattr(message, "target_system", 0) in {0, framing.SYSTEM_ID} and getattr(
        message, "target_component", 0
    ) in {0, framing.COMPONENT_ID}
