"""One client of one link: what it is sent, how its frames are packed, what it may say."""

import logging
from collections.abc import Iterator, Mapping
from typing import Final

from pymavlink.dialects.v20 import common as mavlink

from sitl.mavlink.framing import Frame, Received, Source, Splitter
from sitl.mavlink.link_url import Profile
from sitl.mavlink.links import Client
from sitl.mavlink.signing import Signer
from sitl.mavlink.streams import Schedule
from sitl.mavlink.tlog import TelemetryLog

logger = logging.getLogger(__name__)

MAX_OUTGOING_BYTES: Final = 1400
"""Messages of one moment share datagrams up to what an Ethernet frame carries."""


class Channel:
    """Sequence numbers, rates, protocol version, signatures and waiting frames of one client."""

    def __init__(
        self,
        client: Client,
        profile: Profile,
        time_s: float,
        parameters: Mapping[str, float | int],
        signer: Signer | None,
    ) -> None:
        self.client = client
        self.log: TelemetryLog | None = None
        self.has_ground_station = False
        self.schedule = Schedule(profile, time_s)
        if client.expected:
            self.schedule.start(time_s)
        self._splitter = Splitter(client.in_stream)
        self._signer = signer
        self._parameters = parameters
        self._version = 2
        self._sequence = 0
        self._waiting = bytearray()
        self._refused = False

    def take(self, data: bytes) -> Iterator[Received]:
        """The frames that may be obeyed; the client is answered in its own version of MAVLink."""
        for received in self._splitter.feed(data):
            if self._signer is None:
                self._version = received.version
            elif not self._may_pass(received, self._signer):
                continue
            yield received

    def put(self, frame: Frame, source: Source, time_s: float) -> None:
        packed = self._packed(frame, source)
        if packed is None:
            return
        self._sequence = (self._sequence + 1) % 256
        if self.log is not None:
            self.log.write(time_s, packed)
        self.forward(packed)

    def forward(self, frame: bytes) -> None:
        """Another's frame goes out as it came in."""
        if len(self._waiting) + len(frame) > MAX_OUTGOING_BYTES:
            self.flush()
        self._waiting += frame

    def flush(self) -> None:
        if self._waiting:
            self.client.send(bytes(self._waiting))
            self._waiting.clear()

    def _packed(self, frame: Frame, source: Source) -> bytes | None:
        if (self._parameters["MAV_PROTO_VER"] or self._version) == 1:
            return frame.packed_v1(self._sequence, source)
        if self._signer is None:
            return frame.packed(self._sequence, source)
        return self._signer.sign(frame.packed(self._sequence, source, signed=True))

    def _may_pass(self, received: Received, signer: Signer) -> bool:
        """Who cannot sign may watch: unsigned heartbeats start the streams."""
        if signer.accepts(received):
            return True
        harmless = received.message.get_msgId() == mavlink.MAVLINK_MSG_ID_HEARTBEAT
        if not harmless and not self._refused:
            self._refused = True
            logger.warning(
                "refused %s: this vehicle obeys signed messages only, and its signature is %s",
                received.message.get_type(),
                "wrong or old" if received.signed else "missing",
            )
        return harmless and not received.signed
