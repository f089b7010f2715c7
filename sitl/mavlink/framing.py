"""Frames of MAVLink 2 on the wire: encoded once, numbered for each link, found in datagrams."""

from collections.abc import Iterator
from typing import NamedTuple

from pymavlink.dialects.v20 import common as mavlink

SYSTEM_ID = 1
COMPONENT_ID = mavlink.MAV_COMP_ID_AUTOPILOT1

_SEQUENCE_AT = 4
_SIGNED = 1
_V1_OVERHEAD_BYTES = 8
_V2_OVERHEAD_BYTES = 12
_SIGNATURE_BYTES = 13

_codec = mavlink.MAVLink(None, SYSTEM_ID, COMPONENT_ID)


class Frame(NamedTuple):
    """A packed message with sequence number 0."""

    packed: bytes
    crc_extra: int

    def numbered(self, sequence: int) -> bytes:
        """The same frame with this link's sequence number; MAVLink counts gaps as losses."""
        if sequence == 0:
            return self.packed
        frame = bytearray(self.packed)
        frame[_SEQUENCE_AT] = sequence
        crc = mavlink.x25crc(frame[1:-2] + bytes((self.crc_extra,))).crc
        frame[-2:] = crc.to_bytes(2, "little")
        return bytes(frame)


def encode(message: mavlink.MAVLink_message) -> Frame:
    return Frame(message.pack(_codec), message.crc_extra)


def decode(frame: bytes) -> mavlink.MAVLink_message | None:
    """None for a frame that is damaged or not of the common dialect."""
    try:
        message = _codec.decode(bytearray(frame))
    except mavlink.MAVError:
        return None
    return None if message.get_msgId() not in mavlink.mavlink_map else message


def split(datagram: bytes) -> Iterator[bytes]:
    """The frames of a datagram; bytes that belong to none are skipped."""
    start = 0
    while start + _V1_OVERHEAD_BYTES <= len(datagram):
        length = frame_bytes(datagram, start)
        if length and start + length <= len(datagram):
            yield datagram[start : start + length]
            start += length
        else:
            start += 1


def frame_bytes(datagram: bytes, start: int) -> int:
    """Length that a frame starting here would have; 0 where none starts. Raises ValueError within
    three bytes of the end.
    """
    magic, payload_bytes, flags = datagram[start : start + 3]
    if magic == mavlink.PROTOCOL_MARKER_V2:
        signature = _SIGNATURE_BYTES if flags & _SIGNED else 0
        return payload_bytes + _V2_OVERHEAD_BYTES + signature
    return payload_bytes + _V1_OVERHEAD_BYTES if magic == mavlink.PROTOCOL_MARKER_V1 else 0
