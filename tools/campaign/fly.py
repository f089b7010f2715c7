"""One flight on a worker: lays out its files, flies it in lockstep, brings row and log back."""

import asyncio
import tempfile
import threading
from pathlib import Path

from distributed import get_worker

from companion import __version__
from companion.flight import FlightOrder, fly_plan
from companion.kernel.errors import CompanionError
from companion.logfolder import LOG_NAME
from tools.campaign.plan import PlannedFlight, file_digest
from tools.campaign.rows import Landed, failed_row, row_of

_laying_out = threading.Lock()


def version() -> str:
    """Of the package on this worker."""
    return __version__


def fly_one(flight: PlannedFlight) -> Landed:
    """Flies it; a flight that fails is a row too.

    Rooms are painted and kernels loaded once per worker: flights find them by the path of their
    files, which is the same for the same bytes.
    """
    base = Path(get_worker().local_directory)
    folder = _lay_out(flight, base)
    with tempfile.TemporaryDirectory(dir=base) as log_dir:
        order = FlightOrder(
            plan=flight.plan,
            plan_path=folder / f"{flight.plan_name}.toml",
            vehicle="lockstep",
            log_dir=Path(log_dir),
        )
        try:
            summary = asyncio.run(fly_plan(order, lambda step, pipeline: None, stop_signals=()))
        except CompanionError as error:
            return Landed(failed_row(flight, str(error).replace(f"{folder}/", "")))
        return Landed(row_of(flight, summary), (order.log_dir / LOG_NAME).read_bytes())


def _lay_out(flight: PlannedFlight, base: Path) -> Path:
    """The folder with the flight's files."""
    folder = base / file_digest(flight.files)
    with _laying_out:
        if not folder.is_dir():
            for name, content in flight.files.items():
                path = folder / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
    return folder
