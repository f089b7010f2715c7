"""The paper's Table II: one column per flight and their average.

python -m tools.table2 LOGS ... [--out DIR]

LOGS are summary.json files, flight logs, or folders that hold them. Where a log lies beside its
summary, the summary speaks for it. Prints the table; with --out also writes it as CSV and Markdown.
"""

import argparse
import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import msgspec
import numpy as np

from companion.kernel.errors import PlanError, RecordingError
from companion.kernel.messages import Phase
from companion.logfolder import LOG_NAME, SUMMARY_NAME
from companion.summary import FLOWN_PHASES, format_figure, format_minutes
from tools.drawing import run, save_table
from tools.flown import FlownFlight


class Column(msgspec.Struct, frozen=True, kw_only=True):
    """One flight; None where a figure is undefined. Error, rates and overrides: test phase."""

    room: str
    stereo_flight_s: float | None
    mono_flight_s: float | None
    mse: float | None
    fpr: float | None
    tpr: float | None
    stereo_approaches: float | None
    mono_approaches: float | None
    overrides: float | None
    overrides_per_min: float | None


ROWS = {
    "Stereo flight time m:ss": "stereo_flight_s",
    "Mono flight time m:ss": "mono_flight_s",
    "Mean Square Error": "mse",
    "False Positive Rate": "fpr",
    "True Positive Rate": "tpr",
    "Stereo approaches": "stereo_approaches",
    "Mono approaches": "mono_approaches",
    "Auto-overrides": "overrides",
    "Overrides ratio (per min)": "overrides_per_min",
}
"""The paper's words, and the field that each row shows."""
COUNTS = ("stereo_approaches", "mono_approaches", "overrides")


def read_columns(paths: Iterable[Path]) -> list[Column]:
    """The flights in these files or folders, by room. Raises CompanionError."""
    columns = [column for path in paths for column in _columns_in(path)]
    return sorted(columns, key=lambda column: column.room)


def _columns_in(path: Path) -> Iterator[Column]:
    if path.is_dir():
        flights = {file.parent for name in (SUMMARY_NAME, LOG_NAME) for file in path.rglob(name)}
        if not flights:
            raise PlanError(f"{path}: neither {SUMMARY_NAME} nor {LOG_NAME} in this folder")
        for folder in sorted(flights):
            summary = folder / SUMMARY_NAME
            yield from _columns_in(summary if summary.is_file() else folder / LOG_NAME)
    elif path.suffix == ".json":
        yield column_of_summary(path)
    else:
        yield column_of_log(FlownFlight(path))


def column_of_summary(path: Path) -> Column:
    """Of a summary.json. Raises RecordingError."""
    try:
        column = msgspec.json.decode(path.read_bytes(), type=Column)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error
    except msgspec.MsgspecError as error:
        raise RecordingError(f"{path}: not the summary of a flight: {error}") from error
    return msgspec.structs.replace(column, room=Path(column.room).stem)


def column_of_log(flight: FlownFlight) -> Column:
    """The same, counted anew from the records."""
    accounts = flight.scorecard.accounts
    flown = [accounts[phase] for phase in FLOWN_PHASES]
    test = accounts[Phase.TEST]
    score, test_s = test.score(), test.stereo_flight_s + test.mono_flight_s
    return Column(
        room=flight.room_name,
        stereo_flight_s=sum(account.stereo_flight_s for account in flown),
        mono_flight_s=sum(account.mono_flight_s for account in flown),
        mse=_known(score.mse),
        fpr=_known(score.fpr),
        tpr=_known(score.tpr),
        stereo_approaches=sum(account.stereo_approaches for account in flown),
        mono_approaches=sum(account.mono_approaches for account in flown),
        overrides=test.overrides,
        overrides_per_min=test.overrides / test_s * 60.0 if test_s > 0 else None,
    )


def average(columns: Sequence[Column]) -> Column:
    """The mean of what is known, row by row."""
    means = {}
    for field in ROWS.values():
        known = [value for c in columns if (value := getattr(c, field)) is not None]
        means[field] = float(np.mean(known)) if known else None
    return Column(room="", **means)


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value


def table(columns: Sequence[Column]) -> list[list[str]]:
    """Rows of text: rooms, numbers of the flights, then the paper's rows."""
    shown = [*columns, average(columns)]
    heads = [
        ["Room", *(column.room for column in columns), ""],
        ["Description", *(f"#{number + 1}" for number in range(len(columns))), "Avg."],
    ]
    return heads + [
        [name, *(_cell(field, getattr(column, field)) for column in shown)]
        for name, field in ROWS.items()
    ]


def _cell(field: str, value: float | None) -> str:
    if value is None:
        return "–"
    if field.endswith("_flight_s"):
        return format_minutes(value)
    if field in COUNTS:
        return f"{round(value, 1):g}"
    return format_figure(value)


def text_lines(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    widths = [max(map(len, cells)) for cells in zip(*rows, strict=True)]
    for row in rows:
        first, *rest = (
            cell.ljust(width) if place == 0 else cell.rjust(width)
            for place, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        yield "  ".join((first, *rest)).rstrip()


def markdown_lines(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    yield "| " + " | ".join(rows[0]) + " |"
    yield "|---" + "|--:" * (len(rows[0]) - 1) + "|"
    for row in rows[1:]:
        yield "| " + " | ".join(row) + " |"


def write(columns: Sequence[Column], folder: Path) -> Iterator[Path]:
    """table2.csv with plain numbers, and table2.md."""
    folder.mkdir(parents=True, exist_ok=True)
    shown = [*columns, average(columns)]
    header = ["flight", *(str(number + 1) for number in range(len(columns))), "average"]
    rows = [["room", *(column.room for column in shown)]]
    rows += [[field, *(getattr(column, field) for column in shown)] for field in ROWS.values()]
    yield save_table(folder / "table2.csv", header, rows)
    path = folder / "table2.md"
    path.write_text("\n".join(markdown_lines(table(columns))) + "\n", encoding="utf-8")
    yield path


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.table2",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("logs", type=Path, nargs="+", help="flights, or folders that hold them")
    parser.add_argument("--out", type=Path, help="folder for table2.csv and table2.md")
    args = parser.parse_args(argv)

    def work() -> Iterator[object]:
        columns = read_columns(args.logs)
        yield from text_lines(table(columns))
        if args.out:
            yield from write(columns, args.out)

    return run("table2", work)


if __name__ == "__main__":
    sys.exit(main())
