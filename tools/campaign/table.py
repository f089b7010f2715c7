"""The table of a campaign: on the terminal, and as CSV, JSON and Markdown."""

import math
from collections.abc import Sequence
from pathlib import Path

import msgspec
from rich.console import Console
from rich.table import Table as RichTable

from companion.kernel.errors import CompanionError
from companion.summary import format_figure
from tools.campaign.rows import csv_line
from tools.campaign.stats import RESAMPLES, Comparison, Figure, Group, Table

NAMES = {
    "overrides": "overrides",
    "turns": "turns",
    "collisions": "collisions",
    "coverage_norm": "coverage",
    "mse": "MSE, px²",
    "fpr": "FPR",
    "tpr": "TPR",
    "auc": "AUC",
}
BEHAVIOUR = ("overrides", "turns", "coverage_norm")
ESTIMATE = ("mse", "fpr", "tpr", "auc")
BEHAVIOUR_HEADER = (
    "", "flown", *(NAMES[name] for name in BEHAVIOUR), "collisions per min", "m per collision"
)  # fmt: skip
ESTIMATE_HEADER = ("mono against stereo", *(NAMES[name] for name in ESTIMATE))
PAIR_HEADER = ("figure", "first", "second", "difference", "95 % interval", "p")
UNKNOWN = "–"

Lines = list[tuple[str, ...]]


def print_table(console: Console, table: Table) -> None:
    """Mean ± standard deviation of each group, then the tests between them.

    A figure cut short would be a wrong one: wants 100 columns.
    """
    for header, lines in _blocks(table):
        shown = RichTable()
        for place, name in enumerate(header):
            shown.add_column(name, justify="left" if place == 0 else "right")
        for line in lines:
            shown.add_row(*line)
        console.print(shown)


def write_table(folder: Path, table: Table) -> None:
    """``table.csv`` (groups), ``tests.csv`` (pairs), ``table.json`` and ``table.md``."""
    contents = {
        "table.csv": _group_csv(table.groups),
        "tests.csv": _pair_csv(table.comparisons),
        "table.json": msgspec.json.format(msgspec.json.encode(table), indent=2) + b"\n",
        "table.md": _markdown(table).encode(),
    }
    for name, content in contents.items():
        try:
            (folder / name).write_bytes(content)
        except OSError as error:
            raise CompanionError(f"{folder / name}: cannot be written: {error.strerror}") from error


def _blocks(table: Table) -> list[tuple[Sequence[str], Lines]]:
    blocks: list[tuple[Sequence[str], Lines]] = [
        (BEHAVIOUR_HEADER, [_behaviour_line(group) for group in table.groups]),
        (ESTIMATE_HEADER, [_estimate_line(group) for group in table.groups]),
    ]
    if table.comparisons:
        blocks.append((PAIR_HEADER, [_pair_line(pair) for pair in table.comparisons]))
    return blocks


def _behaviour_line(group: Group) -> tuple[str, ...]:
    flown = f"{group.flown} ({group.failed} failed)" if group.failed else str(group.flown)
    if group.collisions:
        distance = f"{group.distance_per_collision_m:.0f}"
    else:
        distance = f"> {group.distance_flown_m:.0f}"
    figures = (_figure(group.figures[name]) for name in BEHAVIOUR)
    return group.name, flown, *figures, format_figure(group.collisions_per_min), distance


def _estimate_line(group: Group) -> tuple[str, ...]:
    return group.name, *(_figure(group.figures[name]) for name in ESTIMATE)


def _figure(figure: Figure) -> str:
    if math.isnan(figure.mean):
        return UNKNOWN
    if math.isnan(figure.sigma):
        return format_figure(figure.mean)
    return f"{format_figure(figure.mean)} ± {format_figure(figure.sigma)}"


def _pair_line(pair: Comparison) -> tuple[str, ...]:
    interval = f"{pair.low:+.2f} to {pair.high:+.2f}"
    p = f"{pair.p:.4f}"
    return NAMES[pair.figure], pair.first, pair.second, f"{pair.difference:+.2f}", interval, p


def _markdown(table: Table) -> str:
    notes = (
        "Mean ± standard deviation over the flights, in the test phase. Coverage: share of the "
        "0.5 m cells visited in which the hull could be. Tests: second minus first, two-sided "
        f"bootstrap, {RESAMPLES} resamples, seed {table.seed}."
    )
    blocks = (_markdown_block(header, lines) for header, lines in _blocks(table))
    return "\n".join((*blocks, notes)) + "\n"


def _markdown_block(header: Sequence[str], lines: Lines) -> str:
    rule = ("---", *("---:" for _ in header[1:]))
    return "".join(f"| {' | '.join(cells)} |\n" for cells in (header, rule, *lines))


def _group_csv(groups: Sequence[Group]) -> bytes:
    sums = [name for name in Group.__struct_fields__ if name != "figures"]
    parts = [f"{figure}_{part}" for figure in NAMES for part in Figure.__struct_fields__]
    lines = [csv_line((*sums, *parts))]
    for group in groups:
        values = [getattr(group, name) for name in sums]
        values += _figure_values(group)
        lines.append(csv_line(map(str, values)))
    return b"".join(lines)


def _figure_values(group: Group) -> list[float]:
    return [value for name in NAMES for value in msgspec.structs.astuple(group.figures[name])]


def _pair_csv(pairs: Sequence[Comparison]) -> bytes:
    lines = [csv_line(Comparison.__struct_fields__)]
    lines += [csv_line(map(str, msgspec.structs.astuple(pair))) for pair in pairs]
    return b"".join(lines)
