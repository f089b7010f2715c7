"""The performance model (paper section III-E) beside what many flights showed."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from tools import assessment
from tools.agreement import Expectation, agreement, expectation
from tools.assessment import assess
from tools.drawing import colours_of
from tools.report.flight import ReportedFlight
from tools.report.page import Page, paragraph, table

TITLE = "Performance model"
NOTE = (
    "Overrides in the test phase: what the model expects, fitted to the samples of learning or of "
    "the test itself, and what came; observed / expected with a bootstrap interval over flights."
)
HEADER = ("", "flights", "learning", "test", "observed", "observed / learning", "observed / test")


def add_model(groups: Mapping[str, Sequence[ReportedFlight]], page: Page) -> None:
    """The performance model beside what was observed, for flights that mono flew."""
    rng = np.random.default_rng(1)
    found = {
        name: [expectation(assess(flight)) for flight in flights if flight.flew_mono_in_test]
        for name, flights in groups.items()
    }
    found = {name: expectations for name, expectations in found.items() if expectations}
    if not found:
        page.add(TITLE, paragraph("not shown: mono flew no test phase", "quiet"))
        return
    sums = [(name, agreement(expectations, rng)) for name, expectations in found.items()]
    if len(found) > 1:
        sums.append(("all", agreement([e for group in found.values() for e in group], rng)))
    rows = [
        (
            name,
            str(total.flights),
            *(f"{v:.1f}" for v in (total.from_learning, total.from_test, total.observed)),
            *(_ratio(ratio) for ratio in (total.ratio_learning, total.ratio_test)),
        )
        for name, total in sums
    ]
    body = page.figure(expected_and_observed(found, colours_of(groups)), "risk")
    page.add(TITLE, paragraph(NOTE), table(HEADER, rows), body)


def _ratio(ratio: assessment.Figure) -> str:
    if math.isnan(ratio.value):
        return "–"
    return f"{ratio.value:.2f} [{ratio.low:.2f}, {ratio.high:.2f}]"


def expected_and_observed(
    found: Mapping[str, Sequence[Expectation]], colours: Mapping[str, str]
) -> Figure:
    """A dot a flight, its group's mean as a cross; on the line the model is right."""
    figure = Figure(figsize=(6.5, 6.0), layout="constrained")
    axes = figure.subplots()
    for name, expectations in found.items():
        points = np.array([(e.from_learning.value, e.observed) for e in expectations])
        points = points[~np.isnan(points).any(axis=1)]
        axes.plot(*points.T, ".", color=colours[name], alpha=0.6)
        mean = points.mean(axis=0) if len(points) else (np.nan, np.nan)
        axes.plot(*mean, "P", color=colours[name], markeredgecolor="0.1", markersize=11, label=name)
    limit = max(*axes.get_xlim(), *axes.get_ylim())
    axes.plot([0.0, limit], [0.0, limit], "-", color="0.6", linewidth=1, zorder=0)
    axes.set(xlim=(-0.02 * limit, limit), ylim=(-0.02 * limit, limit), aspect="equal")
    axes.set(xlabel="overrides expected from learning", ylabel="overrides observed")
    axes.legend(fontsize=9)
    return figure
