"""ROC curves of flights: mono against stereo in the test phase, and the point it flew at.

python -m tools.roc LOGS ... --out DIR

LOGS are flight logs or folders that hold them. One line style per room, as in the paper; of more
than 24 flights a panel for each room and scheme. Writes roc.png, roc.svg, roc.csv (every corner of
every curve) and roc.json (operating points).
"""

import argparse
import math
import statistics
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import msgspec
import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from companion.judging.performance import RocCurve, roc_curve
from companion.kernel.messages import Phase
from companion.summary import format_figure
from tools.drawing import colours_of, run, save_figure, save_table
from tools.flown import FlownFlight, find_logs
from tools.progress import watched

LINE_STYLES = ("--", "-", ":", "-.")
LEGEND_LIMIT = 24
"""More flights than that are a crowd, a panel for each room and scheme; roc.json names them."""
PANELS_ABREAST = 4


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
    """One curve a flight, dot at the chosen threshold; many are drawn by room and scheme."""
    if len(rocs) > LEGEND_LIMIT:
        groups: dict[str, list[FlightRoc]] = {}
        for roc in rocs:
            groups.setdefault(f"{roc.room}, {roc.scheme.replace('_', ' ')}", []).append(roc)
        return draw_groups(groups, colours_of(groups))
    return _draw_each(rocs)


def _draw_each(rocs: Sequence[FlightRoc]) -> Figure:
    figure = Figure(figsize=(7, 7), layout="constrained")
    axes = figure.subplots()
    colours = colormaps["viridis"](np.linspace(0.0, 0.9, len(rocs)))
    rooms = list(dict.fromkeys(roc.room for roc in rocs))
    for number, (roc, colour) in enumerate(zip(rocs, colours, strict=True), start=1):
        style = LINE_STYLES[rooms.index(roc.room) % len(LINE_STYLES)]
        label = f"#{number} {roc.room}, {roc.scheme.replace('_', ' ')}: AUC {roc.auc:.2f}"
        draw_curve(axes, roc, to_hex(colour), label, style)
    finish(axes)
    return figure


def draw_curve(
    axes: Axes, roc: FlightRoc, colour: str, label: str | None, style: str = "-"
) -> None:
    """A curve and the point that was flown at."""
    axes.plot(roc.curve.fpr, roc.curve.tpr, style, color=colour, linewidth=1.2, label=label)
    axes.plot(roc.fpr, roc.tpr, "o", color=colour, markersize=6)


def draw_groups(groups: Mapping[str, Sequence[FlightRoc]], colours: Mapping[str, str]) -> Figure:
    """A panel a group, none of which is empty: so many curves would hide each other in one."""
    columns, rows = min(len(groups), PANELS_ABREAST), math.ceil(len(groups) / PANELS_ABREAST)
    side_in = 6.0 if columns == 1 else 12.5 / columns
    figure = Figure(figsize=(columns * side_in, rows * (side_in + 1.0)), layout="constrained")
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for axes in panels[len(groups) :]:
        axes.set_axis_off()
    for axes, (name, rocs) in zip(panels, groups.items(), strict=False):
        _draw_crowd(axes, rocs, colours[name])
        finish(axes, legend=False)
        axes.label_outer()
        known = [roc.auc for roc in rocs if not math.isnan(roc.auc)]
        auc = format_figure(statistics.fmean(known) if known else math.nan)
        flights = "1 flight" if len(rocs) == 1 else f"{len(rocs)} flights"
        axes.set_title(f"{name}\n{flights}, AUC {auc}", fontsize=10)
    return figure


def _draw_crowd(axes: Axes, rocs: Sequence[FlightRoc], colour: str) -> None:
    """Darker where more curves are; dots at the chosen thresholds."""
    alpha = max(0.15, 1.0 / math.sqrt(len(rocs)))
    for roc in rocs:
        axes.plot(roc.curve.fpr, roc.curve.tpr, color=colour, linewidth=1.0, alpha=alpha)
    axes.plot([roc.fpr for roc in rocs], [roc.tpr for roc in rocs], ".", color="0.1", markersize=5)


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
