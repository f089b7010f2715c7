"""The parameter protocol with PX4's byte-wise encoding: an INT32's bits travel in the float."""

import math
import struct
import zlib
from collections.abc import Iterator, Mapping
from typing import Final

from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilot.interface import Ack, AutopilotPort
from sitl.autopilot.parameters import Number, default_parameters
from sitl.mavlink.parameter_file import ParameterFile

HASH_NAME: Final = "_HASH_CHECK"
"""Not a parameter: a checksum over all of them, for clients that remember the list."""
_NO_INDEX: Final = 0xFFFF
_FLOAT = struct.Struct("<f")
_INT32 = struct.Struct("<i")
_LOAD, _SAVE, _RESET = 0, 1, 2  # param1 of PREFLIGHT_STORAGE
_INTEGERS: Final = {
    mavlink.MAV_PARAM_TYPE_INT8: struct.Struct("<b3x"),
    mavlink.MAV_PARAM_TYPE_UINT8: struct.Struct("<B3x"),
    mavlink.MAV_PARAM_TYPE_INT16: struct.Struct("<h2x"),
    mavlink.MAV_PARAM_TYPE_UINT16: struct.Struct("<H2x"),
    mavlink.MAV_PARAM_TYPE_INT32: _INT32,
    mavlink.MAV_PARAM_TYPE_UINT32: struct.Struct("<I"),
}


class ParameterProtocol:
    """Answers for one autopilot; ``file`` is where PREFLIGHT_STORAGE keeps what it saves."""

    def __init__(self, autopilot: AutopilotPort, file: ParameterFile | None = None) -> None:
        self._autopilot = autopilot
        self._file = file
        if file is not None:
            self._set_all(file.last)

    def answers(self, message: mavlink.MAVLink_message) -> Iterator[mavlink.MAVLink_message]:
        """PARAM_VALUE answers to PARAM_REQUEST_LIST, PARAM_REQUEST_READ or PARAM_SET.

        As in PX4, a list begins with the checksum, asking for an unknown name is met with silence,
        and a refused PARAM_SET is answered with the value that stays.
        """
        values = self._autopilot.parameters
        names = list(values)
        message_id = message.get_msgId()
        listing = message_id == mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_LIST
        if (listing and values["MAV_HASH_CHK_EN"] == 1) or _asks_for_hash(message):
            yield _hash_value(values)
        if listing:
            wanted = range(len(names))
        else:
            index = _index(names, message)
            wanted = range(index, index + 1) if 0 <= index < len(names) else range(0)
        if message_id == mavlink.MAVLINK_MSG_ID_PARAM_SET and wanted:
            self._autopilot.set_parameter(names[wanted[0]], _decoded(message))
        for index in wanted:
            yield _param_value(names[index], values[names[index]], index, len(names))

    def store(self, action: int) -> Ack:
        """What param1 of PREFLIGHT_STORAGE asks for; without a file there is nowhere to save."""
        if action == _RESET:
            return self._set_all(default_parameters())
        if action not in {_LOAD, _SAVE} or self._file is None:
            return Ack.DENIED
        if action == _LOAD:
            return self._set_all(self._file.last)
        return Ack.ACCEPTED if self._file.save(self._autopilot.parameters) else Ack.FAILED

    def _set_all(self, values: Mapping[str, Number]) -> Ack:
        for name, value in values.items():
            self._autopilot.set_parameter(name, value)
        return Ack.ACCEPTED


def parameters_hash(values: Mapping[str, Number]) -> int:
    """PX4's: CRC-32 without its inversions, over each name and the four bytes of its value."""
    crc = 0xFFFFFFFF
    for name in sorted(values):
        crc = zlib.crc32(name.encode("ascii") + _packed(values[name]), crc)
    return crc ^ 0xFFFFFFFF


def _packed(value: Number) -> bytes:
    return _INT32.pack(value) if isinstance(value, int) else _FLOAT.pack(value)


def _asks_for_hash(message: mavlink.MAVLink_message) -> bool:
    reads = message.get_msgId() == mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ
    return reads and message.param_index < 0 and _text(message.param_id) == HASH_NAME


def _index(names: list[str], message: mavlink.MAVLink_message) -> int:
    """By number if PARAM_REQUEST_READ gives one, else by name; -1 when there is no such name."""
    number = getattr(message, "param_index", -1)
    if number >= 0:
        return int(number)
    name = _text(message.param_id)
    return names.index(name) if name in names else -1


def _text(param_id: str | bytes) -> str:
    text = param_id.decode("ascii", "replace") if isinstance(param_id, bytes) else param_id
    return text.partition("\0")[0]


def _decoded(message: mavlink.MAVLink_message) -> float:
    """NaN for a type that PX4 does not have."""
    kind, value = message.param_type, float(message.param_value)
    if kind == mavlink.MAV_PARAM_TYPE_REAL32:
        return value
    return float(_INTEGERS[kind].unpack(_bits(value))[0]) if kind in _INTEGERS else math.nan


def _bits(value: float) -> bytes:
    try:
        return _FLOAT.pack(value)
    except OverflowError:  # only a message that was not on a wire holds such a number
        return bytes(4)


def _hash_value(values: Mapping[str, Number]) -> mavlink.MAVLink_message:
    bits = parameters_hash(values).to_bytes(4, "little")
    return mavlink.MAVLink_param_value_message(
        HASH_NAME.encode("ascii"),
        _FLOAT.unpack(bits)[0],
        mavlink.MAV_PARAM_TYPE_UINT32,
        len(values),
        _NO_INDEX,
    )


def _param_value(name: str, value: Number, index: int, count: int) -> mavlink.MAVLink_message:
    if isinstance(value, int):
        kind = mavlink.MAV_PARAM_TYPE_INT32
        value = _FLOAT.unpack(_INT32.pack(value))[0]
    else:
        kind = mavlink.MAV_PARAM_TYPE_REAL32
    return mavlink.MAVLink_param_value_message(name.encode("ascii"), value, kind, count, index)
