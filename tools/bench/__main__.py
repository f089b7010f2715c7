"""Prints every row as a table, and writes them as JSON."""

import argparse
import logging
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

import cv2
import msgspec
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from companion.kernel.errors import EXIT_FAILED, EXIT_FLOWN, EXIT_USAGE, CompanionError
from tools.bench.harness import Row

SUBJECTS = (
    *("perception", "odometry", "learning", "camera", "log", "reading", "quality"),
    *("flight", "process", "latency", "realtime"),
)
"""Modules beside this one, each with ``rows() -> Iterator[Row]``; slow ones last."""


def run(subjects: Sequence[str], console: Console) -> list[Row]:
    """All rows of these subjects, shown as they come."""
    modules = [import_module(f"tools.bench.{subject}") for subject in subjects]
    rows: list[Row] = []
    with threadpool_limits(1):  # the idle threads of one contender would slow the other
        for module in modules:
            for row in module.rows():
                console.print(f"{row.name}: {row.value:.4g} {row.unit}", highlight=False)
                rows.append(row)
    return rows


def table_of(rows: Sequence[Row]) -> Table:
    table = Table()
    for header in ("figure", "value", "unit", "goal", "met", "beside", "value", "times better"):
        numeric = header in ("value", "goal", "times better")
        table.add_column(header, justify="right" if numeric else "left")
    for row in rows:
        bound = "≤" if row.better == "less" else "≥"
        table.add_row(
            row.name,
            f"{row.value:.4g}",
            row.unit,
            "" if row.goal is None else f"{bound} {row.goal:g}",
            {None: "", True: "yes", False: "[red]no[/red]"}[row.met],
            row.baseline,
            f"{row.baseline_value:.4g}",
            f"{row.ratio:.3g}",
        )
    return table


def main(argv: Sequence[str] | None = None) -> int:
    """Exit code 0: every goal met, 1: a goal missed or a run failed, 2: usage."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench", description=__doc__)
    parser.add_argument("--only", action="append", choices=SUBJECTS, help="may be repeated")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the rows here")
    options = parser.parse_args(argv)
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(name)s: %(message)s")
    cv2.setNumThreads(1)  # as the app does
    try:
        rows = run(options.only or SUBJECTS, Console(stderr=True))
    except CompanionError as error:
        print(f"bench: {error}", file=sys.stderr)
        return EXIT_FAILED
    Console(width=None if sys.stdout.isatty() else 140).print(table_of(rows))
    if options.json:
        try:
            options.json.write_bytes(msgspec.json.format(msgspec.json.encode(rows)) + b"\n")
        except OSError as error:
            print(f"bench: {options.json}: {error.strerror}", file=sys.stderr)
            return EXIT_USAGE
    return EXIT_FAILED if any(row.met is False for row in rows) else EXIT_FLOWN


if __name__ == "__main__":
    sys.exit(main())
