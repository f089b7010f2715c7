"""The ground stations' log of a link: each frame behind its time in microseconds."""

import struct
from pathlib import Path

from companion.kernel.errors import SimulatorError

_STAMP_US = struct.Struct(">Q")


class TelemetryLog:
    """Stamps are time since the vehicle's boot, so that the same flight gives the same bytes."""

    def __init__(self, path: Path) -> None:
        try:
            self._file = path.open("wb")
        except OSError as error:
            raise SimulatorError(f"{path}: cannot be written: {error.strerror}") from error

    def write(self, time_s: float, frame: bytes) -> None:
        self._file.write(_STAMP_US.pack(round(time_s * 1e6)) + frame)

    def close(self) -> None:
        self._file.close()
