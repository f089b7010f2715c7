"""ROC curves of flights: mono against stereo in the test phase, and the point it flew at.

python -m tools.roc LOGS ... --out DIR

LOGS are flight logs or folders that hold them. One line style per room, as in the paper. Writes
roc.png, roc.svg, roc.csv (every corner of every curve) and roc.json (operating points).
"""

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec
import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from companion.kernel.messages import Phase
from companion.performance import RocCurve, roc_curve
from tools.drawing import run, save_figure, save_table
from tools.flown import FlownFlight, find_logs
from tools.progress import watched

LINE_STYLES = ("--", "-", ":", "-.")
LEGEND_LIMIT = 24
"""More flights than that speak as a crowd; roc.json names them."""


class FlightRoc(msgspec.Struct, frozen=True):
    """One flight's curve, and where its threshold lies on it; NaN without positives."""

    flight: str
    room: str
    scheme: str
    threshold_px: float
    tpr: float
    fpr: float
    auc: float
    curve: RocCurve


def roc_of(flight: FlownFlight, phase: Phase = Phase.TEST) -> FlightRoc:
    """Stereo's turn threshold says what is positive."""
    account = flight.scorecard.accounts[phase]
    stereo_px, mono_px = account.estimates()
    curve = roc_curve(mono_px, stereo_px, flight.plan.behaviour.turn_threshold_px)
    score = account.score()
    return FlightRoc(
        flight.name,
        flight.room_name,
        flight.plan.experiment.scheme,
        flight.mono_threshold_px(phase),
        score.tpr,
        score.fpr,
        score.auc,
        curve,
    )


def draw(rocs: Sequence[FlightRoc]) -> Figure:
    """One curve a flight, dot at the chosen threshold."""
    figure = Figure(figsize=(7, 7), layout="constrained")
    axes = figure.subplots()
    colours = colormaps["viridis"](np.linspace(0.0, 0.9, len(rocs)))
    rooms = list(dict.fromkeys(roc.room for roc in rocs))
    for number, (roc, colour) in enumerate(zip(rocs, colours, strict=True), start=1):
        style = LINE_STYLES[rooms.index(roc.room) % len(LINE_STYLES)]
        label = f"#{number} {roc.room}, {roc.scheme.replace('_', ' ')}: AUC {roc.auc:.2f}"
        draw_curve(axes, roc, to_hex(colour), label, style)
    finish(axes, legend=len(rocs) <= LEGEND_LIMIT)
    return figure


def draw_curve(
    axes: Axes, roc: FlightRoc, colour: str, label: str | None, style: str = "-"
) -> None:
    """A curve and the point that was flown at."""
    axes.plot(roc.curve.fpr, roc.curve.tpr, style, color=colour, linewidth=1.2, label=label)
    axes.plot(roc.fpr, roc.tpr, "o", color=colour, markersize=6)


def draw_crowd(axes: Axes, rocs: Sequence[FlightRoc], colour: str) -> None:
    """Curves that show where many are, with the points that were flown at."""
    alpha = max(0.15, 1.0 / math.sqrt(len(rocs)))
    for roc in rocs:
        axes.plot(roc.curve.fpr, roc.curve.tpr, color=colour, linewidth=1.0, alpha=alpha)
    flown_at = [(roc.fpr, roc.tpr) for roc in rocs]
    axes.plot(*zip(*flown_at, strict=True), ".", color="0.1", markersize=5)


def finish(axes: Axes, legend: bool = True) -> None:
    """What surrounds the curves."""
    axes.plot([0, 1], [0, 1], color="0.8", linewidth=1, zorder=0)
    axes.set(xlabel="false positive rate", ylabel="true positive rate")
    axes.set(xlim=(-0.01, 1.01), ylim=(-0.01, 1.01), aspect="equal")
    if legend:
        axes.legend(loc="lower right", fontsize=8, frameon=False)


def write(rocs: Sequence[FlightRoc], folder: Path) -> Iterator[Path]:
    """The figure and its data."""
    folder.mkdir(parents=True, exist_ok=True)
    yield from save_figure(draw(rocs), folder / "roc")
    rows = (
        (number, roc.flight, *corner)
        for number, roc in enumerate(rocs, start=1)
        for corner in zip(*roc.curve, strict=True)
    )
    yield save_table(folder / "roc.csv", ("number", "flight", "fpr", "tpr", "threshold_px"), rows)
    points = [
        {name: getattr(roc, name) for name in roc.__struct_fields__ if name != "curve"}
        for roc in rocs
    ]
    path = folder / "roc.json"
    path.write_bytes(msgspec.json.format(msgspec.json.encode(points), indent=2) + b"\n")
    yield path


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.roc",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("logs", type=Path, nargs="+", help="flights, or folders that hold them")
    parser.add_argument("--out", type=Path, required=True, help="folder to write to")
    args = parser.parse_args(argv)

    def work() -> Iterator[Path]:
        logs = watched(find_logs(args.logs), "flights")
        yield from write([roc_of(FlownFlight(path)) for path in logs], args.out)

    return run("roc", work)


if __name__ == "__main__":
    sys.exit(main())
