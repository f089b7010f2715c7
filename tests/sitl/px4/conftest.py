"""What is measured against PX4, and written as a table on demand."""

from collections import defaultdict
from datetime import UTC, datetime
from pathlib import Path

import pytest

TABLES = {
    "Rates": ("message", "PX4 v1.17", "measured"),
    "Rates asked for": ("message", "asked", "measured"),
    "Answers": ("command", "state", "COMMAND_ACK"),
    "Failsafes": ("cause", "parameter", "limit", "cause to reaction", "reaction"),
}
"""Columns of what ``px4_row`` takes."""


def pytest_addoption(parser):
    parser.addoption("--px4-table", metavar="FILE", type=Path, help="write what was measured")


@pytest.fixture
def px4_row(record_property):
    """``px4_row(table, *cells)``: one more line of one of the TABLES."""
    return lambda *cells: record_property("px4_row", cells)


def pytest_terminal_summary(terminalreporter, config):
    path = config.getoption("px4_table", default=None)
    if path is None:
        return
    rows = defaultdict(list)
    for report in terminalreporter.getreports("passed") + terminalreporter.getreports("failed"):
        for key, row in report.user_properties:
            if key == "px4_row":
                table, *cells = row
                rows[table].append(cells)
    text = "".join(_markdown(title, head, rows[title]) for title, head in TABLES.items())
    date = datetime.now(UTC).date()
    path.write_text(f"# This vehicle beside PX4 v1.17\n\nSimulated seconds, {date}.\n{text}")


def _markdown(title, head, rows):
    lines = [head, ["---"] * len(head), *rows]
    return f"\n## {title}\n\n" + "".join(f"| {' | '.join(map(str, line))} |\n" for line in lines)
