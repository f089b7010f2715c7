"""What a campaign leaves on disk as it goes: a row per flight, and the flight's log."""

import errno
import fcntl
import os
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Self

from companion.kernel.errors import PlanError, RecordingError
from tools.campaign.plan import PlannedFlight
from tools.campaign.rows import HEADER, Landed, Row, parse_rows, row_line

ROWS_NAME = "results.csv"
LOGS_NAME = "flights"


class ResultsBook:
    """The folder of one campaign. ``rows`` holds what was flown, by id.

    A row is on the disk, after its log, when ``add`` returns; a process that is killed leaves at
    most one row cut off, which the next one takes away. Raises RecordingError where the folder
    cannot be used, PlanError where it holds another campaign.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.rows: dict[str, Row] = {}
        self._descriptor: int | None = None

    def __enter__(self) -> Self:
        path = self.folder / ROWS_NAME
        try:
            (self.folder / LOGS_NAME).mkdir(parents=True, exist_ok=True)
            self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._read(path, self._descriptor)
        except RecordingError:
            self._close()
            raise
        except BlockingIOError:
            self._close()
            raise PlanError(f"{self.folder}: another campaign is writing here") from None
        except OSError as error:
            self._close()
            raise RecordingError(f"{self.folder}: cannot be written: {error.strerror}") from error
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._close()

    def add(self, landed: Landed) -> None:
        """Keeps the log, then the row."""
        assert self._descriptor is not None
        try:
            if landed.log:
                _write_whole(self.log_path(landed.row.id), landed.log)
            _append(self._descriptor, row_line(landed.row))
        except OSError as error:
            raise RecordingError(f"{self.folder}: cannot be written: {error.strerror}") from error
        self.rows[landed.row.id] = landed.row

    def log_path(self, flight_id: str) -> Path:
        return self.folder / LOGS_NAME / f"{flight_id}.mcap"

    def missing(self, flights: Iterable[PlannedFlight]) -> list[PlannedFlight]:
        """Those still to be flown. Raises PlanError when the rows are of other settings."""
        flights = list(flights)
        planned = {(flight.group, flight.seed): flight.id for flight in flights}
        for row in self.rows.values():
            if planned.get((row.group, row.seed), row.id) != row.id:
                raise PlanError(
                    f"{self.folder / ROWS_NAME}: {row.group}, seed {row.seed}, was flown with "
                    "other settings; choose another --out"
                )
        return [flight for flight in flights if flight.id not in self.rows]

    def _read(self, path: Path, descriptor: int) -> None:
        """Takes away what follows the last whole line, and writes the header where none is."""
        content = path.read_bytes()
        self.rows = {row.id: row for row in parse_rows(content, path)}
        whole_bytes = content.rfind(b"\n") + 1
        os.ftruncate(descriptor, whole_bytes)
        if not whole_bytes:
            _append(descriptor, HEADER)

    def _close(self) -> None:
        if self._descriptor is not None:
            os.close(self._descriptor)  # and with it goes the lock
            self._descriptor = None


def _append(descriptor: int, line: bytes) -> None:
    """In one call, so that no two lines mix; a disk that takes less of it is full."""
    if os.write(descriptor, line) != len(line):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    os.fsync(descriptor)


def _write_whole(path: Path, content: bytes) -> None:
    """All of it or nothing, whatever happens meanwhile."""
    part = path.with_suffix(".part")
    with part.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)
