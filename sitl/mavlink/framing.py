"""Frames of MAVLink on the wire: encoded once, packed for each client, found among other bytes."""

import re
from collections.abc import Iterator
from typing import NamedTuple

from pymavlink.dialects.v10 import common as mavlink1
from pymavlink.dialects.v20 import common as mavlink

_MAGIC_1, _MAGIC_2 = mavlink.PROTOCOL_MARKER_V1, mavlink.PROTOCOL_MARKER_V2
_MAGIC = re.compile(bytes((ord("["), _MAGIC_1, _MAGIC_2, ord("]"))))
_SIGNED = mavlink.MAVLINK_IFLAG_SIGNED
_V1_HEADER_BYTES = 6
_V2_HEADER_BYTES = 10
_CHECKSUM_BYTES = 2
SIGNATURE_BYTES = 13


class Source(NamedTuple):
    """Who sends."""

    system_id: int = 1
    component_id: int = mavlink.MAV_COMP_ID_AUTOPILOT1


class Frame(NamedTuple):
    """An encoded message that nobody has sent yet; the payload is MAVLink 2's, zeros cut off."""

    message_id: int
    payload: bytes
    crc_extra: int

    def packed(self, sequence: int, source: Source, *, signed: bool = False) -> bytes:
        """As MAVLink 2; a ``signed`` frame still lacks its signature."""
        flags = _SIGNED if signed else 0
        header = bytes((_MAGIC_2, len(self.payload), flags, 0, sequence, *source))
        return self._checked(header + self.message_id.to_bytes(3, "little") + self.payload)

    def packed_v1(self, sequence: int, source: Source) -> bytes | None:
        """As MAVLink 1, without extension fields; None for a message that it does not have."""
        known = mavlink1.mavlink_map.get(self.message_id)
        if known is None:
            return None
        payload = self.payload[: known.unpacker.size].ljust(known.unpacker.size, b"\0")
        header = bytes((_MAGIC_1, len(payload), sequence, *source, self.message_id))
        return self._checked(header + payload)

    def _checked(self, frame: bytes) -> bytes:
        crc: int = mavlink.x25crc(frame[1:] + bytes((self.crc_extra,))).crc
        return frame + crc.to_bytes(_CHECKSUM_BYTES, "little")


class Received(NamedTuple):
    frame: bytes
    message: mavlink.MAVLink_message

    @property
    def version(self) -> int:
        return 1 if self.frame[0] == _MAGIC_1 else 2

    @property
    def signed(self) -> bool:
        return self.version == 2 and bool(self.frame[2] & _SIGNED)


_codec = mavlink.MAVLink(None)


def encode(message: mavlink.MAVLink_message) -> Frame:
    message.pack(_codec)
    return Frame(message.get_msgId(), bytes(message.get_payload()), message.crc_extra)


def decode(frame: bytes) -> mavlink.MAVLink_message | None:
    """None for a frame that is damaged or not of the common dialect."""
    try:
        message = _codec.decode(bytearray(frame))
    except mavlink.MAVError:
        return None
    return None if message.get_msgId() not in mavlink.mavlink_map else message


class Splitter:
    """Finds the sound frames among what one client sends; all other bytes are skipped.

    In a ``stream`` a frame may come in pieces; a datagram holds whole frames.
    """

    def __init__(self, stream: bool) -> None:
        self._stream = stream
        self._rest = b""

    def feed(self, data: bytes) -> Iterator[Received]:
        data = self._rest + data
        start = 0
        while (magic := _MAGIC.search(data, start)) is not None:
            start = magic.start()
            length = _frame_bytes(data, start)
            if self._stream and (length is None or start + length > len(data)):
                break
            frame = data[start : start + length] if length else b""
            message = decode(frame) if frame else None
            if message is None:
                start += 1
            else:
                yield Received(frame, message)
                start += len(frame)
        self._rest = data[start:] if self._stream and magic is not None else b""


def split(datagram: bytes) -> Iterator[bytes]:
    """The sound frames of a datagram."""
    return (received.frame for received in Splitter(stream=False).feed(datagram))


def _frame_bytes(data: bytes, start: int) -> int | None:
    """Length of the frame whose magic stands here: 0 if none can be, None if more must be seen."""
    if data[start] == _MAGIC_1:
        if len(data) < start + _V1_HEADER_BYTES:
            return None
        known = data[start + 5] in mavlink.mavlink_map
        return _V1_HEADER_BYTES + data[start + 1] + _CHECKSUM_BYTES if known else 0
    if len(data) < start + _V2_HEADER_BYTES:
        return None
    flags = data[start + 2]
    if flags & ~_SIGNED or int.from_bytes(data[start + 7 : start + 10], "little") not in (
        mavlink.mavlink_map
    ):
        return 0
    signature = SIGNATURE_BYTES if flags & _SIGNED else 0
    return _V2_HEADER_BYTES + data[start + 1] + _CHECKSUM_BYTES + signature
