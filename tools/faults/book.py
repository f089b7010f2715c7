"""Rows of the matrix on the disk, each as it lands: the same command goes on where it ended."""

import csv
from collections.abc import Iterable, Iterator
from pathlib import Path

import msgspec

from companion.kernel.errors import RecordingError
from tools.faults.lockstep import Task
from tools.faults.results import Flown

HEADER = (*Flown._fields, "as_expected")


class Book:
    """``faults.csv``. Raises RecordingError where it cannot be read or written, or is another's."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._rows: dict[tuple[object, ...], Flown] = {}
        try:
            text = path.read_text(encoding="utf-8") if path.exists() else ""
            whole = text[: text.rfind("\n") + 1]  # a process that was killed may leave half a line
            header, *rows = csv.reader(whole.splitlines()) if whole else [HEADER]
            if tuple(header) != HEADER:
                raise RecordingError(f"{path}: not a table of tools.faults; choose another --out")
            for row in rows:
                self._keep(msgspec.convert(row[:-1], Flown, strict=False))
            with path.open("w", newline="", encoding="utf-8") as file:
                csv.writer(file, lineterminator="\n").writerows([HEADER, *rows])
        except msgspec.ValidationError as error:
            raise RecordingError(f"{path}: {error}; choose another --out") from error
        except OSError as error:
            raise RecordingError(f"{path}: cannot be used: {error.strerror}") from error

    def add(self, flown: Flown) -> None:
        """Written when it returns."""
        self._keep(flown)
        with self.path.open("a", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerow([*flown, flown.as_expected])

    def missing(self, way: str, tasks: Iterable[Task]) -> list[Task]:
        """Those not flown yet."""
        return [task for task in tasks if _key(way, task) not in self._rows]

    def of(self, way: str, tasks: Iterable[Task]) -> Iterator[Flown]:
        """What came of these tasks, in their order."""
        return (self._rows[_key(way, task)] for task in tasks)

    def _keep(self, flown: Flown) -> None:
        key = (flown.way, flown.case, flown.moment, flown.room, flown.seed)
        self._rows[key] = flown


def _key(way: str, task: Task) -> tuple[object, ...]:
    return way, task.case.name, task.moment, task.room, task.seed
