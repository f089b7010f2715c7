"""The far side of a link: a ground station that listens, and asks for what it wants to hear."""

import math
from collections.abc import Collection

from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.clock import wall_s
from companion.kernel.errors import PlanError
from sitl.conditions import CLEAR
from sitl.mavlink import framing
from sitl.mavlink.link_url import parse_link
from sitl.mavlink.links import UdpLink

SYSTEM_ID = 255
COMPONENT_ID = mavlink.MAV_COMP_ID_MISSIONPLANNER
BEAT_PERIOD_S = 1.0
"""Wall time: an autopilot forgets a client that does not beat."""
_V2_ID = slice(7, 10)
_V1_ID = slice(5, 6)


class Listener:
    """Keeps the messages of some ids that an autopilot sends. Never blocks."""

    def __init__(self, url: str, message_ids: Collection[int]) -> None:
        if not url.startswith(("udpin://", "udpout://")):
            raise PlanError(f"{url}: not a UDP link; use udpin://HOST:PORT or udpout://HOST:PORT")
        if parse_link(url).conditions != CLEAR:
            raise PlanError(f"{url}: this end only listens; let the autopilot's lose and delay")
        self._link = UdpLink(url)
        self._wanted = frozenset((*message_ids, mavlink.MAVLINK_MSG_ID_HEARTBEAT))
        self._codec = mavlink.MAVLink(None, SYSTEM_ID, COMPONENT_ID)
        self._beat_wall_s = -math.inf
        self.system_id: int | None = None
        """Of the autopilot, once it was heard."""

    @property
    def url(self) -> str:
        return self._link.url

    def fileno(self) -> int:
        return self._link.socket.fileno()

    def receive(self) -> list[mavlink.MAVLink_message]:
        """All that has come since the last call, oldest first; beats when that is due."""
        messages = []
        while (arrived := self._link.receive()) is not None:
            client, datagram = arrived
            for frame in framing.split(datagram):
                client.admit()
                if _message_id(frame) in self._wanted and (message := framing.decode(frame)):
                    messages.append(message)
        kept = [message for message in messages if self._is_the_autopilots(message)]
        if wall_s() - self._beat_wall_s > BEAT_PERIOD_S:
            self._beat_wall_s = wall_s()
            self._send(_HEARTBEAT)
        return kept

    def ask_for(self, message_id: int, rate_hz: float) -> None:
        """SET_MESSAGE_INTERVAL; whether it is obeyed shows in what comes."""
        self._send(
            mavlink.MAVLink_command_long_message(
                self.system_id or 0,
                mavlink.MAV_COMP_ID_AUTOPILOT1,
                mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
                *(0, message_id, 1e6 / rate_hz, 0, 0, 0, 0, 0),
            )
        )

    def close(self) -> None:
        self._link.close()

    def _send(self, message: mavlink.MAVLink_message) -> None:
        frame = message.pack(self._codec)
        for client in self._link.clients:
            client.send(frame)
        self._codec.seq = (self._codec.seq + 1) % 256

    def _is_the_autopilots(self, message: mavlink.MAVLink_message) -> bool:
        """The first system that beats as an autopilot is the one; others are not listened to."""
        if message.get_msgId() == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            if self.system_id is None and message.autopilot != mavlink.MAV_AUTOPILOT_INVALID:
                self.system_id = message.get_srcSystem()
                self._beat_wall_s = -math.inf  # what was sent before may have reached nobody
            return False
        return self.system_id is None or message.get_srcSystem() == self.system_id


_HEARTBEAT = mavlink.MAVLink_heartbeat_message(
    mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
)


def _message_id(frame: bytes) -> int:
    second = frame[0] == mavlink.PROTOCOL_MARKER_V2
    return int.from_bytes(frame[_V2_ID if second else _V1_ID], "little")
