"""Finds out what kind of log a file is, by its first bytes."""

from collections.abc import Callable
from pathlib import Path

from companion.kernel.errors import RecordingError
from tools.logs.flight import MCAP_MAGIC, FlightReader
from tools.logs.series import LogReader
from tools.logs.tlog import TelemetryReader, looks_like_tlog
from tools.logs.ulog import ULOG_MAGIC, ULogReader

FLIGHT_LOG_NAME = "flight.mcap"
_HEAD_BYTES = 64


def find_log(path: Path) -> Path:
    """The file itself, or the flight log in a log folder. Raises RecordingError."""
    if not path.is_dir():
        return path
    inside = path / FLIGHT_LOG_NAME
    if not inside.exists():
        raise RecordingError(f"{path}: a folder without {FLIGHT_LOG_NAME}")
    return inside


def open_log(path: Path) -> LogReader:
    """Raises RecordingError for what is no log of a known kind."""
    path = find_log(path)
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error
    return _reader(path, head)(path)


def _reader(path: Path, head: bytes) -> Callable[[Path], LogReader]:
    if head.startswith(MCAP_MAGIC):
        return FlightReader
    if head.startswith(ULOG_MAGIC):
        return ULogReader
    if looks_like_tlog(head):
        return TelemetryReader
    what = "empty" if not head else "no log of a known kind (MCAP, .tlog, PX4 .ulg)"
    raise RecordingError(f"{path}: {what}")
