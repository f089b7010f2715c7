"""The ground stations' log of a link: each frame behind its time in microseconds."""

import logging
import struct
from contextlib import suppress
from pathlib import Path

from companion.kernel.errors import SimulatorError

logger = logging.getLogger(__name__)

_STAMP_US = struct.Struct(">Q")


class TelemetryLog:
    """Stamps are time since the vehicle's boot, so that the same flight gives the same bytes.

    A disk that fills up ends the log, not the flight.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._file = path.open("wb")
        except OSError as error:
            raise SimulatorError(f"{path}: cannot be written: {error.strerror}") from error

    def write(self, time_s: float, frame: bytes) -> None:
        if self._file.closed:
            return
        try:
            self._file.write(_STAMP_US.pack(round(time_s * 1e6)) + frame)
        except OSError as error:
            logger.error("%s: ends here: %s", self._path, error.strerror)
            self.close()

    def close(self) -> None:
        with suppress(OSError):  # what could not be written is lost; the file is closed anyway
            self._file.close()
