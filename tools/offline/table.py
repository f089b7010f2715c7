"""What a study found: a row per run, and their means by variant, split and size."""

import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import msgspec
import numpy as np
from rich.console import Console
from rich.table import Table

from tools.drawing import save_table
from tools.offline.study import Study
from tools.offline.trial import Row, Score

FIGURES = ("mse", "mse_over_variance", "auc", "fpr")
HEADER = (
    "learner", "dimension", "setting", "split", "fold", "seed", "size", "n_learned",
    *(f"{name}_{side}" for side in ("train", "test") for name in ("n", *FIGURES)),
)  # fmt: skip


class Spread(msgspec.Struct, frozen=True):
    """Of one figure over folds and seeds; NaN where no run has it."""

    mean: float
    """Of ``mse_over_variance``: the runs' mean MSE over the mean variance of their sets, since a
    set that hardly varies would outweigh all others."""
    std: float
    """Of the sample; 0 for one run."""


class Side(msgspec.Struct, frozen=True):
    """The figures of one set."""

    mse: Spread
    mse_over_variance: Spread
    auc: Spread
    fpr: Spread


class Point(msgspec.Struct, frozen=True, kw_only=True):
    """One variant on one split after one number of samples."""

    learner: str
    dimension: str
    setting: str
    split: str
    size: int
    n_learned: float
    """Mean over the folds."""
    runs: int
    train: Side
    test: Side

    @property
    def name(self) -> str:
        dimension = "" if self.dimension == "setting" else self.dimension.rpartition(".")[2]
        setting = self.setting.rpartition("/")[2]
        return " ".join(filter(None, (self.learner, dimension, setting)))


class Provenance(msgspec.Struct, frozen=True):
    """Where the figures come from."""

    command: str
    date: str
    seeds: tuple[int, ...]
    recordings: dict[str, int]
    """Pairs of each."""


class Report(msgspec.Struct, frozen=True):
    study: str
    question: str
    made: Provenance
    points: tuple[Point, ...]


def summarise(rows: Sequence[Row]) -> tuple[Point, ...]:
    """Means and deviations over folds and seeds, in the order of the rows.

    A fold that has fewer samples than others counts with all it has: every mean is of all folds.
    """
    variants: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        key = row.learner, row.dimension, row.setting, row.split
        variants.setdefault(key, []).append(row)
    return tuple(point for group in variants.values() for point in _curve(group))


def _curve(rows: Sequence[Row]) -> Iterator[Point]:
    """One variant on one split, by size."""
    runs: dict[tuple[int, int], list[Row]] = {}
    for row in rows:
        runs.setdefault((row.fold, row.seed), []).append(row)
    before: list[Row] = []
    for size in sorted({row.size for row in rows}, key=lambda size: size or math.inf):
        group = [_at(size, run) for run in runs.values()]
        if group != before:
            yield _point(size, group)
        before = group


def _at(size: int, run: Sequence[Row]) -> Row:
    return next((row for row in run if row.size == size), run[-1])


def _point(size: int, group: Sequence[Row]) -> Point:
    return Point(
        learner=group[0].learner,
        dimension=group[0].dimension,
        setting=group[0].setting,
        split=group[0].split,
        size=size,
        n_learned=float(np.mean([row.n_learned for row in group])),
        runs=len(group),
        train=_side([row.train for row in group]),
        test=_side([row.test for row in group]),
    )


def _side(scores: Sequence[Score]) -> Side:
    side = Side(*(_spread([getattr(score, name) for score in scores]) for name in FIGURES))
    variances = [score.mse / score.mse_over_variance for score in scores if score.mse > 0.0]
    if not variances:
        return side
    ratio = msgspec.structs.replace(
        side.mse_over_variance, mean=side.mse.mean / float(np.mean(variances))
    )
    return msgspec.structs.replace(side, mse_over_variance=ratio)


def _spread(values: Iterable[float]) -> Spread:
    known = [value for value in values if not math.isnan(value)]
    if not known:
        return Spread(math.nan, math.nan)
    return Spread(float(np.mean(known)), float(np.std(known, ddof=min(1, len(known) - 1))))


def write_tables(folder: Path, study: Study, rows: Sequence[Row], report: Report) -> list[Path]:
    """``NAME.csv``, a line per run, and ``NAME.json``, the summary."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = (
        (
            *(getattr(row, name) for name in HEADER[:8]),
            *(getattr(s, n) for s in (row.train, row.test) for n in ("n", *FIGURES)),
        )
        for row in rows
    )
    path = folder / f"{study.name}.json"
    path.write_bytes(encode(report))
    return [save_table(folder / f"{study.name}.csv", HEADER, lines), path]


def encode(report: Report) -> bytes:
    """JSON with four digits, a point a line; NaN is null."""
    told = msgspec.to_builtins(report)
    points = [msgspec.json.encode(_rounded(point)) for point in told.pop("points")]
    head = msgspec.json.format(msgspec.json.encode(told), indent=2).removesuffix(b"\n}")
    return head + b',\n  "points": [\n' + b",\n".join(points) + b"\n  ]\n}\n"


def _rounded(value: object) -> object:
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    return float(f"{value:.4g}") if isinstance(value, float) else value


def print_report(console: Console, report: Report) -> None:
    """Means, with the deviation of what matters most."""
    table = Table(title=report.question or report.study)
    for name in ("", "split"):
        table.add_column(name, no_wrap=True)
    for name in ("samples", "runs", "MSE train", "MSE test, px²", "MSE/var train",
                 "MSE/var test", "AUC train", "AUC test", "FPR at TPR 0.96"):  # fmt: skip
        table.add_column(name, justify="right", no_wrap=True)
    for point in report.points:
        train, test = point.train, point.test
        table.add_row(
            point.name,
            point.split,
            f"{point.n_learned:.0f}",
            str(point.runs),
            *(_cell(figure) for figure in (train.mse, test.mse)),
            _cell(train.mse_over_variance),
            _cell(test.mse_over_variance),
            _cell(train.auc, digits=3),
            _cell(test.auc, digits=3, spread=True),
            _cell(test.fpr),
        )
    console.print(table)


def _cell(figure: Spread, digits: int = 2, spread: bool = False) -> str:
    if math.isnan(figure.mean):
        return "–"
    text = f"{figure.mean:.{digits}f}"
    return f"{text} ± {figure.std:.{digits}f}" if spread else text
