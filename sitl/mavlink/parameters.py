"""The parameter protocol with PX4's byte-wise encoding: an INT32's bits travel in the float."""

import struct
from collections.abc import Iterator

from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilot.interface import AutopilotPort

_FLOAT = struct.Struct("<f")
_INT32 = struct.Struct("<i")


def requested_values(
    autopilot: AutopilotPort, message: mavlink.MAVLink_message
) -> Iterator[mavlink.MAVLink_message]:
    """PARAM_VALUE answers to PARAM_REQUEST_LIST, PARAM_REQUEST_READ or PARAM_SET.

    As in PX4, asking for an unknown name is met with silence, and a refused PARAM_SET is answered
    with the value that stays.
    """
    names = list(autopilot.parameters)
    message_id = message.get_msgId()
    if message_id == mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_LIST:
        wanted = range(len(names))
    else:
        index = _index(names, message)
        wanted = range(index, index + 1) if 0 <= index < len(names) else range(0)
    if message_id == mavlink.MAVLINK_MSG_ID_PARAM_SET and wanted:
        autopilot.set_parameter(names[wanted[0]], _decoded(message))
    values = autopilot.parameters
    for index in wanted:
        yield _param_value(names[index], values[names[index]], index, len(names))


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
    if message.param_type == mavlink.MAV_PARAM_TYPE_INT32:
        return float(_INT32.unpack(_FLOAT.pack(message.param_value))[0])
    return float(message.param_value)


def _param_value(name: str, value: float | int, index: int, count: int) -> mavlink.MAVLink_message:
    if isinstance(value, int):
        kind = mavlink.MAV_PARAM_TYPE_INT32
        value = _FLOAT.unpack(_INT32.pack(value))[0]
    else:
        kind = mavlink.MAV_PARAM_TYPE_REAL32
    return mavlink.MAVLink_param_value_message(name.encode("ascii"), value, kind, count, index)
