"""Many flights on one page: groups side by side, and every flight as a row."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from companion.kernel.errors import CompanionError, RecordingError
from companion.summary import Summary, format_figure
from tools import heatmap, roc
from tools.drawing import colours_of
from tools.report.figures import NO_CURVE
from tools.report.flight import ReportedFlight
from tools.report.model import add_model
from tools.report.page import Page, paragraph, table
from tools.report.plans import plans_flown

MEASURES: dict[str, Callable[[Summary], float]] = {
    "overrides": lambda summary: summary.overrides,
    "turns": lambda summary: summary.turns,
    "MSE, px²": lambda summary: summary.mse,
    "TPR": lambda summary: summary.tpr,
    "FPR": lambda summary: summary.fpr,
    "AUC": lambda summary: summary.auc,
    "collisions": lambda summary: math.nan if summary.collisions is None else summary.collisions,
}
"""Of the test phase; collisions of the whole flight, NaN without truth."""
NOTE = "Mean ± standard deviation of the test phase; collisions are those of the whole flight."

Flights = Sequence[ReportedFlight]


class CampaignFigure(NamedTuple):
    """As ``sections.FigureSection``, of all flights."""

    title: str
    name: str
    draw: Callable[[Flights], Figure]


def campaign_page(flights: Flights, unreadable: Sequence[str], page: Page) -> None:
    """``unreadable``: one line for each log that could not be taken in."""
    groups = grouped(flights)
    page.add("Groups", paragraph(NOTE), _groups(groups))
    for section in (*FIGURES, *heat_maps(flights)):
        try:
            body = page.figure(section.draw(flights), section.name)
        except CompanionError as error:
            body = paragraph(f"not shown: {error}", "quiet")
        page.add(section.title, body)
    add_model(groups, page)
    page.add("Flights", _rows(flights))
    page.add("Plans as flown", plans_flown(flights))
    if unreadable:
        page.add("Not shown", *(paragraph(line, "problem") for line in unreadable))


def grouped(flights: Flights) -> dict[str, list[ReportedFlight]]:
    """By room and scheme."""
    groups: dict[str, list[ReportedFlight]] = {}
    for flight in flights:
        name = f"{flight.plan.room or 'room unknown'}, {flight.plan.experiment.scheme}"
        groups.setdefault(name, []).append(flight)
    return dict(sorted(groups.items()))


def _groups(groups: dict[str, list[ReportedFlight]]) -> str:
    rows = []
    for name, flights in groups.items():
        summaries = [flight.summary for flight in flights]
        flown = sum(summary.outcome == "flown" for summary in summaries)
        figures = [_spread([measure(s) for s in summaries]) for measure in MEASURES.values()]
        rows.append((name, f"{flown} of {len(flights)}", *figures))
    return table(("", "flown", *MEASURES), rows)


def _spread(values: Sequence[float]) -> str:
    known = [value for value in values if not np.isnan(value)]
    if not known:
        return "–"
    spread = f" ± {np.std(known, ddof=1):.2f}" if len(known) > 1 else ""
    return f"{np.mean(known):.2f}{spread}"


def _rows(flights: Flights) -> str:
    rows = [
        (
            flight.name,
            flight.summary.scheme,
            str(flight.summary.seed),
            f"{flight.summary.outcome}{', log cut off' if flight.log.truncated else ''}",
            *(_cell(measure(flight.summary)) for measure in MEASURES.values()),
        )
        for flight in flights
    ]
    return table(("", "scheme", "seed", "outcome", *MEASURES), rows)


def _cell(value: float) -> str:
    return str(value) if isinstance(value, int) else format_figure(value)


def counts(flights: Flights) -> Figure:
    """Overrides and turns of every flight, by group, with the group's mean."""
    groups = grouped(flights)
    colours = colours_of(groups)
    figure = Figure(figsize=(12, 1.4 + 0.55 * len(groups)), layout="constrained")
    for axes, name in zip(figure.subplots(1, 2, sharey=True), ("overrides", "turns"), strict=True):
        for row, (group, members) in enumerate(groups.items()):
            values = np.array([MEASURES[name](flight.summary) for flight in members])
            shift = np.linspace(-0.18, 0.18, len(values)) if len(values) > 1 else np.zeros(1)
            axes.plot(values, row + shift, ".", color=colours[group])
            axes.plot([values.mean()], [row], "|", color="0.1", markersize=18)
        axes.set(xlabel=f"{name} in the test phase", yticks=range(len(groups)))
        axes.set_yticklabels(list(groups), fontsize=9)
        axes.set_xlim(left=-0.5, right=axes.get_xlim()[1] + 0.5)
    axes.invert_yaxis()  # shared: the first group on top in both
    return figure


def roc_curves(flights: Flights) -> Figure:
    """The test phase of every flight, a panel a group, with the points that they flew at.

    Raises RecordingError where no flight has a curve.
    """
    groups = grouped(flights)
    curves = {name: [roc.roc_of(flight) for flight in members] for name, members in groups.items()}
    known = {name: [curve for curve in c if not np.isnan(curve.auc)] for name, c in curves.items()}
    known = {name: of_group for name, of_group in known.items() if of_group}
    if not known:
        raise RecordingError(NO_CURVE)
    return roc.draw_groups(known, colours_of(groups))


def heat_maps(flights: Flights) -> list[CampaignFigure]:
    """One for each room, all schemes side by side."""
    rooms = sorted({flight.room_name for flight in flights})
    return [
        CampaignFigure(
            f"Heat map, {name or 'room unknown'}", f"heatmap-{name}", partial(heat_map, name)
        )
        for name in rooms
    ]


def heat_map(room_name: str, flights: Flights) -> Figure:
    """Of all phases. Raises CompanionError without the room, or where nobody was in it."""
    here = [flight for flight in flights if flight.room_name == room_name]
    room = here[0].load_room()
    grid = heatmap.grid_over(room, heatmap.CELL_M)
    heats = heatmap.heat_of(here, grid)
    if not heats:
        raise RecordingError(f"no flight was inside of {room_name}")
    return heatmap.draw(heats, grid, room)


FIGURES: list[CampaignFigure] = [
    CampaignFigure("Overrides and turns", "counts", counts),
    CampaignFigure("ROC curves", "roc", roc_curves),
]
