"""The figure of a study: learning curves, one panel per dimension, or a list of variants."""

import math
from collections.abc import Sequence
from itertools import cycle
from typing import Final, NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullLocator

from tools.offline.study import SETTING
from tools.offline.table import Point, Report, Side, Spread

PALETTE = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000"
"""Wong's: told apart by colour-blind readers too."""
FIT: Final = "--"
UNSEEN: Final = "-"
"""Training and test set, as in the paper."""


class Metric(NamedTuple):
    name: str
    title: str
    limits: tuple[float, float]

    def of(self, side: Side) -> Spread:
        spread: Spread = getattr(side, self.name)
        return spread


MSE = Metric("mse_over_variance", "MSE / variance", (0.0, 1.6))
"""Beyond 1 the mean would have been the better answer; far beyond, it says no more. Deviations
are not drawn: single sets that hardly vary would fill the figure."""
AUC = Metric("auc", "AUC", (0.45, 1.01))
BANDS = 3
"""With more lines, bands would hide each other."""
FPR = Metric("fpr", "FPR at TPR 0.96", (0.0, 1.0))


def draw(report: Report) -> Figure:
    """The kind of figure that shows what the study varied."""
    sizes = {point.size for point in report.points}
    if len(sizes) > 1:
        return _draw_curves(report.points)
    if all(_is_dimension(report.points, name) for name in _dimensions(report.points)):
        return _draw_dimensions(report.points, report.question)
    return _draw_list(report.points)


def _dimensions(points: Sequence[Point]) -> list[str]:
    return list(dict.fromkeys(point.dimension for point in points))


def _is_dimension(points: Sequence[Point], name: str) -> bool:
    """Settings that stand in tables of their own are one if they are all numbers."""
    own = {point.setting for point in points if point.dimension == name}
    return name != "" and (name != SETTING or all(map(_is_number, own)))


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _colours(names: Sequence[str]) -> dict[str, str]:
    return dict(zip(names, cycle(PALETTE), strict=False))


def _draw_curves(points: Sequence[Point]) -> Figure:
    """Against the number of samples: a column per split, a line per variant."""
    splits = list(dict.fromkeys(point.split for point in points))
    names = list(dict.fromkeys(point.name for point in points))
    sizes = sorted({point.size for point in points} - {0})
    colours = _colours(names)
    figure = Figure(figsize=(4.6 * len(splits) + 1.2, 6.2), layout="constrained")
    grid = figure.subplots(2, len(splits), squeeze=False, sharex="col", sharey="row")
    for column, split in enumerate(splits):
        grid[0, column].set_title(split, fontsize=10)
        for axes, metric in zip(grid[:, column], (MSE, AUC), strict=True):
            for name in names:
                own = [p for p in points if p.split == split and p.name == name]
                _draw_line(axes, metric, [p.n_learned for p in own], own, colours[name])
                if len(names) <= BANDS:
                    _draw_band(axes, metric, [p.n_learned for p in own], own, colours[name])
            axes.set_xscale("log")
            axes.set_xticks(sizes, [str(size) for size in sizes], minor=False)
            axes.xaxis.set_minor_locator(NullLocator())
            _finish(axes, metric)
        grid[1, column].set_xlabel("samples learned")
    _legend(figure, colours)
    return figure


def _draw_dimensions(points: Sequence[Point], question: str) -> Figure:
    """A column per dimension, a line per split and learner."""
    dimensions = _dimensions(points)
    names = list(dict.fromkeys(_line_name(point) for point in points))
    colours = _colours(names)
    figure = Figure(figsize=(2.1 * len(dimensions) + 2.2, 5.2), layout="constrained")
    grid = figure.subplots(2, len(dimensions), squeeze=False, sharex="col", sharey="row")
    for column, dimension in enumerate(dimensions):
        labels = list(dict.fromkeys(p.setting for p in points if p.dimension == dimension))
        for axes, metric in zip(grid[:, column], (MSE, AUC), strict=True):
            for name in names:
                own = [p for p in points if p.dimension == dimension and _line_name(p) == name]
                places = [labels.index(p.setting) for p in own]
                _draw_line(axes, metric, places, own, colours[name])
                if len(names) <= BANDS:
                    _draw_band(axes, metric, places, own, colours[name])
            axes.set_xticks(range(len(labels)), [_short(label) for label in labels], fontsize=7)
            _finish(axes, metric)
        title = question if dimension == SETTING else _short(dimension)
        grid[1, column].set_xlabel(title, fontsize=8)
    _legend(figure, colours)
    return figure


def _line_name(point: Point) -> str:
    return ", ".join(filter(None, (point.learner, point.split)))


def _short(text: str) -> str:
    """A key without its tables, a path without its folders."""
    last = text.rpartition("/")[2]
    return last if _is_number(last) else last.rpartition(".")[2]


def _draw_list(points: Sequence[Point]) -> Figure:
    """A line of dots per variant; training set hollow."""
    names = list(dict.fromkeys(point.name for point in points))
    colours = _colours(list(dict.fromkeys(point.split for point in points)))
    figure = Figure(figsize=(10.5, 0.36 * len(names) + 1.6), layout="constrained")
    panels = figure.subplots(1, 3, sharey=True)
    for axes, metric in zip(panels, (MSE, AUC, FPR), strict=True):
        for number, point in enumerate(points):
            height = names.index(point.name) + 0.16 * (number % 2)
            test, train = metric.of(point.test), metric.of(point.train)
            reach = None if metric is MSE else test.std
            axes.errorbar(
                test.mean, height, xerr=reach, fmt="o", color=colours[point.split], markersize=4
            )
            axes.plot(train.mean, height, "o", color=colours[point.split], mfc="none", markersize=4)
        axes.set(xlabel=metric.title, xlim=metric.limits)
        axes.grid(axis="x", linewidth=0.4)
    panels[0].set_yticks(range(len(names)), names)
    panels[0].invert_yaxis()
    handles = [
        Line2D([], [], color=c, marker="o", linestyle="", label=n) for n, c in colours.items()
    ]
    handles.append(
        Line2D([], [], color="0.4", marker="o", mfc="none", linestyle="", label="training set")
    )
    figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return figure


def _draw_line(
    axes: Axes, metric: Metric, places: Sequence[float], points: Sequence[Point], colour: str
) -> None:
    test, train = ([metric.of(s).mean for s in side] for side in _sides(points))
    axes.plot(places, train, FIT, color=colour, linewidth=1)
    axes.plot(places, test, UNSEEN, color=colour, linewidth=1.5, marker="o", markersize=3)


def _draw_band(
    axes: Axes, metric: Metric, places: Sequence[float], points: Sequence[Point], colour: str
) -> None:
    """One deviation of the test set to both sides."""
    if metric is MSE:
        return
    spreads = [metric.of(side) for side in _sides(points)[0]]
    low, high = ([s.mean + sign * s.std for s in spreads] for sign in (-1.0, 1.0))
    axes.fill_between(places, low, high, color=colour, alpha=0.12, linewidth=0)


def _sides(points: Sequence[Point]) -> tuple[list[Side], list[Side]]:
    return [point.test for point in points], [point.train for point in points]


def _finish(axes: Axes, metric: Metric) -> None:
    axes.set_ylim(metric.limits)
    axes.grid(linewidth=0.4)
    place = axes.get_subplotspec()
    if place is None or place.is_first_col():
        axes.set_ylabel(metric.title)


def _legend(figure: Figure, colours: dict[str, str]) -> None:
    handles = [Line2D([], [], color=colour, label=name) for name, colour in colours.items() if name]
    handles += [
        Line2D([], [], color="0.4", linestyle=UNSEEN, label="test set"),
        Line2D([], [], color="0.4", linestyle=FIT, label="training set"),
    ]
    figure.legend(handles=handles, loc="outside right upper", fontsize=8, frameon=False)
