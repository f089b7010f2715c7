"""A flight, or all flights of a folder, as one HTML file that needs nothing else.

python -m tools.report LOG|CAMPAIGN_DIR [--out DIR]
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from companion.kernel.errors import EXIT_FLOWN, CompanionError, RecordingError
from companion.logfolder import LOG_NAME
from tools.flown import find_flights
from tools.progress import watched
from tools.report.campaign import campaign_page
from tools.report.flight import ReportedFlight
from tools.report.page import Page
from tools.report.sections import flight_page

REPORT_NAME = "report.html"
FIGURES_NAME = "figures"


def report(path: Path, out: Path | None = None, room: Path | None = None) -> Path:
    """Writes the report of a log, a log folder, or a folder of many. Raises CompanionError."""
    if path.is_dir() and (path / LOG_NAME).exists():
        path = path / LOG_NAME
    folder = out or (path if path.is_dir() else path.parent)
    page = _campaign(path, folder) if path.is_dir() else _flight(path, folder, room)
    target = folder / REPORT_NAME
    try:
        folder.mkdir(parents=True, exist_ok=True)
        target.write_text(page.html(), encoding="utf-8")
    except OSError as error:
        raise RecordingError(f"{target}: cannot be written: {error.strerror}") from error
    return target


def _flight(path: Path, folder: Path, room: Path | None) -> Page:
    flight = ReportedFlight(path, room)
    page = Page(flight.name, folder / FIGURES_NAME)
    flight_page(flight, page)
    return page


def _campaign(path: Path, folder: Path) -> Page:
    """A log that cannot be read becomes a line on the page; where none can, it is an error."""
    flights, unreadable = [], []
    for log in watched(find_flights(path), "flights read"):
        try:
            flight = ReportedFlight(log)
            flight.read_through()
            flights.append(flight)
        except CompanionError as error:
            unreadable.append(str(error))
    if not flights:
        raise RecordingError(unreadable[0] if unreadable else f"{path}: holds no flight log")
    page = Page(path.resolve().name, folder / FIGURES_NAME)
    campaign_page(flights, unreadable, page)
    return page


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tools.report", description=__doc__)
    parser.add_argument("path", type=Path, help="flight.mcap, its folder, or a folder of many")
    parser.add_argument("--out", type=Path, help="folder for report.html and figures/")
    parser.add_argument("--room", type=Path, help="TOML file of the room, if not a shipped one")
    args = parser.parse_args(argv)
    try:
        print(report(args.path, args.out, args.room))
    except CompanionError as error:
        print(f"report: {error}", file=sys.stderr)
        return error.exit_code
    return EXIT_FLOWN


if __name__ == "__main__":
    sys.exit(main())
