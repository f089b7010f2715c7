"""A log's series as one CSV or Parquet file each."""

import csv
import importlib
import re
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from companion.flightlog import Topic
from companion.kernel.errors import CompanionError, RecordingError
from tools.logs.series import LogReader, Table

Format = Literal["csv", "parquet"]
Writer = Callable[[Path, dict[str, NDArray[Any]]], None]
IMAGES = (Topic.LEFT, Topic.RIGHT)
"""No time series; ``tools.record`` copies them into a recording."""


def export(
    log: LogReader,
    out: Path,
    form: Format = "csv",
    series: Collection[str] = (),
    offset_s: float = 0.0,
) -> list[Path]:
    """Writes the named series, by default all; their column ``time_s`` is moved by ``offset_s``.

    Vectors become one column per element. Raises RecordingError.
    """
    known = [name for name in log.records() if name not in IMAGES]
    strange = sorted(set(series) - set(known))
    if strange:
        raise RecordingError(
            f"{log.path}: no series {', '.join(strange)}; it holds: {', '.join(known)}"
        )
    write = _parquet_writer() if form == "parquet" else _write_csv
    written = []
    try:
        out.mkdir(parents=True, exist_ok=True)
        for name in series or known:
            path = out / f"{_file_stem(name)}.{form}"
            write(path, flat(log.table(name), offset_s))
            written.append(path)
    except OSError as error:
        raise RecordingError(f"{out}: cannot be written: {error.strerror or error}") from error
    return written


def flat(table: Table, offset_s: float = 0.0) -> dict[str, NDArray[Any]]:
    """Every column of shape (n,), time first."""
    columns: dict[str, NDArray[Any]] = {"time_s": table.time_s + offset_s}
    for name, column in table.columns.items():
        if column.ndim == 1:
            columns[name] = column
        else:
            columns |= {f"{name}[{i}]": column[:, i] for i in range(column.shape[1])}
    return columns


def _file_stem(series: str) -> str:
    return re.sub(r"[^\w.@\[\]-]+", ".", series.strip("/"))


def _write_csv(path: Path, columns: dict[str, NDArray[Any]]) -> None:
    """Numbers at full precision; unknown (NaN) is an empty cell."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*(_cells(column) for column in columns.values()), strict=True))


def _cells(column: NDArray[Any]) -> list[Any]:
    if np.issubdtype(column.dtype, np.floating):
        return ["" if np.isnan(value) else value for value in column.tolist()]
    return list(column.tolist())


def _parquet_writer() -> Writer:
    """Parquet needs a large library, which is an extra of its own."""
    try:
        arrow = importlib.import_module("pyarrow")
        parquet = importlib.import_module("pyarrow.parquet")
    except ImportError as error:
        raise CompanionError(
            "Parquet needs pyarrow (pip install 'mono-companion[parquet]'); CSV does not"
        ) from error

    def write(path: Path, columns: dict[str, NDArray[Any]]) -> None:
        parquet.write_table(arrow.table(columns), path)

    return write
