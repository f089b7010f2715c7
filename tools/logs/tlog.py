"""A ground station's telemetry log: MAVLink frames, each behind its time in microseconds."""

import struct
from collections import Counter
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from companion.flightlog.schema import table
from companion.kernel.errors import RecordingError
from sitl.mavlink.framing import SIGNATURE_BYTES, Source, decode
from tools.logs.series import Finding, Health, Table, backward_steps, problem, remark

_STAMP_US = struct.Struct(">Q")
_V1_MAGIC, _V2_MAGIC = 0xFE, 0xFD
_SIGNED = 1
_V1_OVERHEAD_BYTES = 8
_V2_OVERHEAD_BYTES = 12
_SHORTEST_BYTES = _STAMP_US.size + _V1_OVERHEAD_BYTES  # an empty MAVLink 1 frame
_SEQUENCES = 256
ALLOWED_STEP_BACK_S = 0.1
"""Ground stations stamp a frame when it was made or came in, and write it a little later."""


class _Entry(NamedTuple):
    """Where a frame lies, and who sent it."""

    time_us: int
    start: int
    length: int
    source: tuple[int, int]
    """System and component."""
    sequence: int
    message_id: int


def looks_like_tlog(head: bytes) -> bool:
    return len(head) >= _SHORTEST_BYTES and _frame_bytes(head, _STAMP_US.size) > 0


class TelemetryReader:
    """Series are message names; those of others than the autopilot end in ``@system.component``.

    Frames are decoded when their series is asked for: a long log has hundreds of thousands.
    """

    kind = "telemetry log (MAVLink)"

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._data = path.read_bytes()
        except OSError as error:
            raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error
        self._skipped_bytes = 0
        self._entries: dict[tuple[tuple[int, int], int], list[_Entry]] = {}
        for entry in self._index():
            self._entries.setdefault((entry.source, entry.message_id), []).append(entry)
        if not self._entries:
            raise RecordingError(f"{path}: holds no MAVLink frame")

    def facts(self) -> dict[str, str]:
        sources = sorted({source for source, _ in self._entries})
        return {"senders": ", ".join(f"{system}.{component}" for system, component in sources)}

    def records(self) -> dict[str, int]:
        return {name: len(entries) for name, entries in sorted(self._series.items())}

    def table(self, series: str) -> Table:
        if series not in self._series:
            raise RecordingError(f"{self.path}: no message {series}")
        times_us, rows = [], []
        for entry in self._series[series]:
            message = decode(self._frame(entry))
            if message is not None:
                times_us.append(entry.time_us)
                rows.append({name: getattr(message, name) for name in message.get_fieldnames()})
        return Table(np.array(times_us, dtype=np.float64) * 1e-6, table(rows))

    def examine(self) -> Health:
        damaged = sum(
            decode(self._frame(entry)) is None
            for entries in self._series.values()
            for entry in entries
        )
        findings = [remark("every frame has the right checksum")] if not damaged else []
        if damaged:
            findings.append(problem(f"{damaged} frames with a wrong checksum"))
        if self._skipped_bytes:
            findings.append(problem(f"{self._skipped_bytes} bytes belong to no whole frame"))
        unknown = self._unknown
        if unknown:
            text = ", ".join(f"{count} of id {number}" for number, count in sorted(unknown.items()))
            findings.append(remark(f"messages that the common dialect does not know: {text}"))
        return Health(self.records(), findings + self._over_time())

    def _over_time(self) -> list[Finding]:
        """Order and losses, per sender."""
        by_source: dict[tuple[int, int], list[_Entry]] = {}
        for entries in self._entries.values():
            by_source.setdefault(entries[0].source, []).extend(entries)
        found: list[Finding] = []
        for source, entries in sorted(by_source.items()):
            entries.sort(key=lambda entry: entry.start)
            name = "sender {}.{}".format(*source)
            times_us = np.array([entry.time_us for entry in entries], dtype=np.float64)
            found += backward_steps(name, times_us * 1e-6, ALLOWED_STEP_BACK_S)
            steps = np.diff([entry.sequence for entry in entries]) % _SEQUENCES
            lost = int(np.sum((steps - 1) % _SEQUENCES))
            if lost:
                found.append(remark(f"{name}: {lost} frames lost on the link, by their numbers"))
        return found

    @cached_property
    def _series(self) -> dict[str, list[_Entry]]:
        series = {}
        for (source, _), entries in self._entries.items():
            message = next(filter(None, (decode(self._frame(entry)) for entry in entries)), None)
            if message is not None:
                suffix = "" if source[1] == Source().component_id else "@{}.{}".format(*source)
                series[message.get_type() + suffix] = entries
        return series

    @property
    def _unknown(self) -> Counter[int]:
        known = {entries[0].message_id for entries in self._series.values()}
        return Counter(
            {
                number: len(entries)
                for (_, number), entries in self._entries.items()
                if number not in known
            }
        )

    def _frame(self, entry: _Entry) -> bytes:
        return self._data[entry.start : entry.start + entry.length]

    def _index(self) -> list[_Entry]:
        data, found, at = self._data, [], 0
        while at + _SHORTEST_BYTES <= len(data):
            start = at + _STAMP_US.size
            length = _frame_bytes(data, start)
            if length and self._is_frame(start, start + length):
                found.append(_entry(data, at, start, length))
                at = start + length
            else:
                at += 1
                self._skipped_bytes += 1
        self._skipped_bytes += len(data) - at
        return found

    def _is_frame(self, start: int, end: int) -> bool:
        """A magic byte proves nothing: another frame must follow, or the checksum be right."""
        data = self._data
        if end > len(data):
            return False
        follower = end + _STAMP_US.size
        follows = follower + 3 > len(data) or _frame_bytes(data, follower) > 0
        return follows or decode(data[start:end]) is not None


def _frame_bytes(data: bytes, start: int) -> int:
    """Length that a frame starting here would have, of any dialect, even damaged; else 0."""
    head = data[start : start + 3]
    if len(head) == 3 and head[0] == _V2_MAGIC:
        signed = head[2] & _SIGNED
        return head[1] + _V2_OVERHEAD_BYTES + (SIGNATURE_BYTES if signed else 0)
    if len(head) == 3 and head[0] == _V1_MAGIC:
        return head[1] + _V1_OVERHEAD_BYTES
    return 0


def _entry(data: bytes, at: int, start: int, length: int) -> _Entry:
    (time_us,) = _STAMP_US.unpack_from(data, at)
    head: Any = data[start : start + 10]
    if head[0] == _V2_MAGIC:
        message_id = int.from_bytes(head[7:10], "little")
        return _Entry(time_us, start, length, (head[5], head[6]), head[4], message_id)
    return _Entry(time_us, start, length, (head[3], head[4]), head[2], head[5])
