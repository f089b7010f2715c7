"""Commands about messages and parameters: carried out by the link's side, not by the autopilot."""

from collections.abc import Callable, Mapping, Sequence

from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilot.interface import Ack
from sitl.mavlink.channel import Channel
from sitl.mavlink.commands import REQUESTS, Parameters, whole
from sitl.mavlink.parameters import ParameterProtocol
from sitl.mavlink.snapshot import Message, Snapshot

Builders = Mapping[int, Callable[[Snapshot], Message | None]]
Outcome = tuple[Ack, Sequence[Message]]
"""The verdict, and what is to be sent behind it."""

_FOLLOWERS = {
    mavlink.MAVLINK_MSG_ID_CAMERA_INFORMATION: (mavlink.MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION,)
}
"""What goes with a message unasked: MAVSDK asks for the stream only 20 s after the camera."""
_DENIED: Outcome = (Ack.DENIED, ())


class LinkCommands:
    """``builders`` make the messages that can be requested."""

    def __init__(self, builders: Builders, parameters: ParameterProtocol) -> None:
        self._builders = builders
        self._parameters = parameters
        self._handlers: Mapping[int, Callable[[Channel, Parameters, Snapshot], Outcome]] = {
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
            mavlink.MAV_CMD_GET_MESSAGE_INTERVAL: self._get_interval,
            mavlink.MAV_CMD_REQUEST_MESSAGE: lambda _, p, now: self._request(whole(p[0]), now),
            mavlink.MAV_CMD_PREFLIGHT_STORAGE: self._store,
        }

    def execute(
        self, channel: Channel, command: int, parameters: Parameters, now: Snapshot
    ) -> Outcome | None:
        """None for a command that is the autopilot's."""
        if command in REQUESTS:
            return self._request(REQUESTS[command], now)
        handler = self._handlers.get(command)
        return None if handler is None else handler(channel, parameters, now)

    def _set_interval(self, channel: Channel, p: Parameters, now: Snapshot) -> Outcome:
        known = channel.schedule.set_interval(whole(p[0]), p[1], now.time_s)
        return (Ack.ACCEPTED, ()) if known else _DENIED

    def _get_interval(self, channel: Channel, p: Parameters, _: Snapshot) -> Outcome:
        message_id = whole(p[0])
        if not 0 <= message_id <= 0xFFFF:
            return _DENIED
        interval_us = channel.schedule.interval_us(message_id)
        return Ack.ACCEPTED, (mavlink.MAVLink_message_interval_message(message_id, interval_us),)

    def _request(self, message_id: int, now: Snapshot) -> Outcome:
        if message_id not in self._builders:
            return _DENIED
        wanted = (message_id, *_FOLLOWERS.get(message_id, ()))
        messages = [m for number in wanted if (m := self._builders[number](now)) is not None]
        return (Ack.ACCEPTED, messages) if messages else _DENIED

    def _store(self, _channel: Channel, p: Parameters, _now: Snapshot) -> Outcome:
        return self._parameters.store(whole(p[0])), ()
