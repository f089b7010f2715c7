"""The vehicle's side of its links: what it answers, and what it sends unasked."""

import logging
from collections.abc import Callable, Mapping, Sequence

from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilot.interface import AutopilotPort, StatusText
from sitl.mavlink import framing
from sitl.mavlink.camera import CameraDescription
from sitl.mavlink.channel import Channel
from sitl.mavlink.command_protocol import CommandProtocol
from sitl.mavlink.link_commands import LinkCommands
from sitl.mavlink.links import Client, Link
from sitl.mavlink.missions import MissionProtocol
from sitl.mavlink.parameter_file import ParameterFile
from sitl.mavlink.parameters import ParameterProtocol
from sitl.mavlink.places import Earth, Origin
from sitl.mavlink.setpoints import SetpointReader, manual_input
from sitl.mavlink.signing import Keyring, Signer
from sitl.mavlink.snapshot import Snapshot
from sitl.mavlink.state import gps_global_origin, heartbeat
from sitl.mavlink.streams import STREAMS
from sitl.mavlink.tlog import TelemetryLog
from sitl.mavlink.vision import VisionReader

logger = logging.getLogger(__name__)

MAX_DATAGRAMS_PER_POLL = 64
"""So that a flooding client cannot stop the world."""


class MavlinkServer:
    """Serves one autopilot on several links; call ``poll`` and ``update`` between two steps."""

    def __init__(
        self,
        autopilot: AutopilotPort,
        links: Sequence[Link],
        log: TelemetryLog | None = None,
        *,
        camera: CameraDescription | None = None,
        keyring: Keyring | None = None,
        parameter_file: ParameterFile | None = None,
        origin: Origin | None = None,
    ) -> None:
        """``log`` keeps what the first link sends to its first client and all that it receives;
        closed by ``close``. With a ``keyring`` only signed messages are obeyed.
        """
        self._autopilot = autopilot
        self._earth = earth = Earth(origin or Origin(), autopilot.plans.home)
        self.links = links
        self._log = log
        self._keyring = keyring
        self._time_s = autopilot.estimate.time_s
        self._parameters = ParameterProtocol(autopilot, parameter_file)
        self._missions = MissionProtocol(autopilot, earth)
        self._setpoints = SetpointReader(earth)
        self._vision = VisionReader()
        self._source = _source_of(autopilot)
        self._channels: dict[Client, Channel] = {}
        builders = {message_id: stream.builder for message_id, stream in STREAMS.items()}
        if camera is not None:
            builders |= camera.builders
        link_commands = LinkCommands(builders, self._parameters)
        self._commands = CommandProtocol(autopilot, earth, link_commands)
        self._handlers: Mapping[int, Callable[[Channel, mavlink.MAVLink_message], None]] = {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: self._on_heartbeat,
            mavlink.MAVLINK_MSG_ID_COMMAND_LONG: self._on_command,
            mavlink.MAVLINK_MSG_ID_COMMAND_INT: self._on_command,
            mavlink.MAVLINK_MSG_ID_SET_GPS_GLOBAL_ORIGIN: self._on_global_origin,
            mavlink.MAVLINK_MSG_ID_MANUAL_CONTROL: self._on_manual_control,
            mavlink.MAVLINK_MSG_ID_TIMESYNC: self._on_timesync,
            mavlink.MAVLINK_MSG_ID_PING: self._on_ping,
            mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ: self._on_parameter,
            mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: self._on_parameter,
            mavlink.MAVLINK_MSG_ID_PARAM_SET: self._on_parameter,
            **dict.fromkeys(self._missions.handlers, self._on_mission),
            **dict.fromkeys(self._setpoints.message_ids, self._on_setpoint),
            **dict.fromkeys(self._vision.message_ids, self._on_vision),
        }

    def filenos(self) -> list[int]:
        """What becomes readable when there is something to ``poll``."""
        return [fileno for link in self.links for fileno in link.filenos()]

    @property
    def channels(self) -> list[Channel]:
        """One for each client of each link, as of now."""
        present = [(client, link) for link in self.links for client in link.clients]
        if len(present) != len(self._channels) or any(c not in self._channels for c, _ in present):
            self._channels = {
                client: self._channels.get(client) or self._new_channel(client, link)
                for client, link in present
            }
            self._assign_log()
        return list(self._channels.values())

    def poll(self) -> None:
        """Takes and answers all that has arrived."""
        for link in self.links:
            for _ in range(MAX_DATAGRAMS_PER_POLL):
                arrived = link.receive()
                if arrived is None:
                    break
                self._take(link, *arrived)
        for channel in self.channels:
            channel.flush()

    def update(self, time_s: float) -> None:
        """Sends what is due at this time of the world; a message is encoded once for all."""
        self._time_s = time_s
        frames: dict[int, framing.Frame | None] = {}
        now: Snapshot | None = None
        channels = self.channels
        for channel in channels:
            for message_id in channel.schedule.due(time_s):
                if message_id not in frames:
                    now = now or self._snapshot()
                    message = STREAMS[message_id].builder(now)
                    frames[message_id] = None if message is None else framing.encode(message)
                if (frame := frames[message_id]) is not None:
                    channel.put(frame, self._source, time_s)
        for message in self._missions.update():
            for channel in channels:
                self._send(channel, message)
        for text in self._autopilot.drain_status_texts():
            self._put_status_text(text, time_s)
        for channel in channels:
            channel.flush()

    def beat(self) -> None:
        """One heartbeat more than is due: for a world whose time stands still."""
        frame = framing.encode(heartbeat(self._snapshot()))
        for channel in self.channels:
            channel.put(frame, self._source, self._time_s)
            channel.flush()

    def close(self) -> None:
        for link in self.links:
            link.close()
        if self._log is not None:
            self._log.close()

    def _new_channel(self, client: Client, link: Link) -> Channel:
        signer = Signer(self._keyring, self.links.index(link)) if self._keyring else None
        return Channel(
            client,
            link.profile,
            self._time_s,
            self._autopilot.parameters,
            signer,
        )

    def _assign_log(self) -> None:
        """Of several clients of the first link the one that came first is written down."""
        first = next(iter(self.links[0].clients), None) if self.links else None
        for client, channel in self._channels.items():
            channel.log = self._log if client is first else None

    def _snapshot(self) -> Snapshot:
        autopilot = self._autopilot
        return Snapshot(
            autopilot.estimate,
            autopilot.status,
            self._time_s,
            autopilot.parameters,
            self._earth.origin,
            autopilot.sensors,
            autopilot.quality,
        )

    def _take(self, link: Link, client: Client, data: bytes) -> None:
        """Who has never sent a sound frame is not a client, however much else it sends."""
        channel = self._channels.get(client) or self._new_channel(client, link)
        for received in channel.take(data):
            if client not in self._channels:
                if not client.admit():
                    return
                self._channels[client] = channel
                self._assign_log()
            if self._log is not None and link is self.links[0]:
                self._log.write(self._time_s, received.frame)
            if received.message.get_msgId() == mavlink.MAVLINK_MSG_ID_STATUSTEXT:
                self._forward(channel, received.frame)
            self._obey(channel, received.message)

    def _forward(self, sender: Channel, frame: bytes) -> None:
        """What a component says to everybody reaches the other links too, as with PX4."""
        for channel in self.channels:
            if channel is not sender:
                channel.forward(frame)

    def _obey(self, channel: Channel, message: mavlink.MAVLink_message) -> None:
        handler = self._handlers.get(message.get_msgId())
        if handler is not None and self._is_for_us(message):
            handler(channel, message)

    def _is_for_us(self, message: mavlink.MAVLink_message) -> bool:
        """A component that is not there is answered by none."""
        system_id, component_id = self._source
        return getattr(message, "target_system", 0) in {0, system_id} and getattr(
            message, "target_component", 0
        ) in {0, component_id}

    def _send(self, channel: Channel, message: mavlink.MAVLink_message) -> None:
        channel.put(framing.encode(message), self._source, self._time_s)

    def _put_status_text(self, status: StatusText, time_s: float) -> None:
        """As PX4: only to links on which a ground station was heard."""
        logger.info("autopilot: %s", status.text)
        text = status.text.encode("ascii", "replace")[:50]
        frame = framing.encode(mavlink.MAVLink_statustext_message(int(status.severity), text))
        for channel in self.channels:
            if channel.has_ground_station:
                channel.put(frame, self._source, time_s)

    def _on_heartbeat(self, channel: Channel, message: mavlink.MAVLink_message) -> None:
        channel.schedule.start(self._time_s)
        if message.type == mavlink.MAV_TYPE_GCS:
            channel.has_ground_station = True
            self._autopilot.hear_ground_station()

    def _on_command(self, channel: Channel, message: mavlink.MAVLink_message) -> None:
        rebooted = self._commands.obey(
            channel, message, self._snapshot(), lambda answer: self._send(channel, answer)
        )
        if rebooted:
            channel.flush()
            self._source = _source_of(self._autopilot)
            self._channels.clear()

    def _on_setpoint(self, _: Channel, message: mavlink.MAVLink_message) -> None:
        setpoint = self._setpoints.read(message, self._autopilot.estimate)
        if setpoint is not None:
            self._autopilot.set_offboard_setpoint(setpoint)

    def _on_manual_control(self, _: Channel, message: mavlink.MAVLink_message) -> None:
        if message.target in {0, self._source.system_id}:
            self._autopilot.set_manual_input(manual_input(message))

    def _on_vision(self, _: Channel, message: mavlink.MAVLink_message) -> None:
        sample = self._vision.read(message)
        if sample is not None:
            self._autopilot.take_vision(sample)

    def _on_global_origin(self, channel: Channel, message: mavlink.MAVLink_message) -> None:
        """Answered with the origin of now, whether it moved or not."""
        self._earth.move(message)
        self._send(channel, gps_global_origin(self._snapshot()))

    def _on_timesync(self, channel: Channel, message: mavlink.MAVLink_message) -> None:
        if message.tc1 == 0:  # a question; anything else answers one
            now_ns = round(self._time_s * 1e9)
            self._send(channel, mavlink.MAVLink_timesync_message(now_ns, message.ts1))

    def _on_ping(self, channel: Channel, message: mavlink.MAVLink_message) -> None:
        if message.target_system == 0 and message.target_component == 0:
            sender = message.get_srcSystem(), message.get_srcComponent()
            self._send(
                channel, mavlink.MAVLink_ping_message(message.time_usec, message.seq, *sender)
            )

    def _on_parameter(self, channel: Channel, message: mavlink.MAVLink_message) -> None:
        for answer in self._parameters.answers(message):
            self._send(channel, answer)

    def _on_mission(self, channel: Channel, message: mavlink.MAVLink_message) -> None:
        handler = self._missions.handlers[message.get_msgId()]
        handler(message, lambda answer: self._send(channel, answer))


def _source_of(autopilot: AutopilotPort) -> framing.Source:
    values = autopilot.parameters
    return framing.Source(int(values["MAV_SYS_ID"]), int(values["MAV_COMP_ID"]))
