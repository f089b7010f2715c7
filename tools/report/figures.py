"""The report's own figures."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from companion.kernel.errors import RecordingError
from companion.kernel.messages import Phase
from companion.summary import format_figure
from tools import flightpath, roc
from tools.drawing import COLOURS
from tools.logs import open_log
from tools.logs.align import Alignment, align, signals
from tools.report.flight import ReportedFlight

STRIP_S = 60.0
NO_CURVE = "stereo never called a frame blocked, or never clear"
AXIS = {"yaw rate": "yaw rate, rad/s", "height": "down, m"}
PHASE_COLOURS = {Phase.LEARNING: "0.55", Phase.TEST: COLOURS["mono"]}


def disparity_strips(flight: ReportedFlight) -> Figure:
    """λ of both cues over time, one strip a minute; turns are shaded, overrides marked."""
    time_s, percept, decision = flight.time_s, flight.percept, flight.decision
    count = int(time_s[-1] // STRIP_S) + 1
    figure = Figure(figsize=(12, 1.0 + 1.15 * count), layout="constrained")
    panels = figure.subplots(count, 1, squeeze=False, sharey=True)[:, 0]
    known = percept["stereo_px"][np.isfinite(percept["stereo_px"])]
    top_px = 1.1 * float(np.percentile(known, 99.5)) if len(known) else 1.0
    for number, axes in enumerate(panels):
        begin_s = number * STRIP_S
        # One sample more on either side, so that lines reach the edges.
        first, last = np.searchsorted(time_s, (begin_s, begin_s + STRIP_S))
        _draw_strip(axes, flight, slice(max(0, first - 1), last + 1), top_px)
        axes.set(xlim=(begin_s, begin_s + STRIP_S), ylim=(0, top_px), ylabel="λ, px")
        axes.set_title(str(decision["phase"][first]), loc="right", fontsize=8, pad=2)
    panels[-1].set_xlabel("time since the first frame, s")
    panels[0].legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=5, frameon=False, fontsize=8)
    return figure


def _draw_strip(axes: Axes, flight: ReportedFlight, shown: slice, top_px: float) -> None:
    time_s = flight.time_s[shown]
    percept, decision = (
        {name: column[shown] for name, column in columns.items()}
        for columns in (flight.percept, flight.decision)
    )
    turning, overriding = decision["state"] != "straight", decision["override"].astype(bool)
    axes.fill_between(time_s, 0, top_px, where=turning, color="0.9", linewidth=0, label="turning")
    rust = COLOURS["override"]
    axes.fill_between(
        time_s, 0, top_px, where=overriding, color=rust, alpha=0.35, linewidth=0, label="override"
    )
    for cue in ("stereo", "mono"):
        axes.plot(time_s, percept[f"{cue}_px"], color=COLOURS[cue], linewidth=0.9, label=cue)
    axes.plot(time_s, decision["threshold_px"], color="0.3", linewidth=0.7, label="threshold")


def roc_curves(flight: ReportedFlight) -> Figure:
    """Mono against stereo's verdict, by phase, with the point that the flight flew at.

    Raises RecordingError without any.
    """
    figure = Figure(figsize=(5.5, 5.0), layout="constrained")
    axes = figure.subplots()
    for phase, colour in PHASE_COLOURS.items():
        curve = roc.roc_of(flight, phase)
        if not np.isnan(curve.auc):
            label = f"{phase}, AUC {format_figure(curve.auc)}"
            roc.draw_curve(axes, curve, colour, label)
    if not axes.lines:
        raise RecordingError(NO_CURVE)
    roc.finish(axes)
    return figure


def six_panels(flight: ReportedFlight) -> Figure:
    """The path by λ and mono's errors. Raises CompanionError without truth or room."""
    room = flight.room or flight.load_room()  # which says what is missing
    return flightpath.draw(flightpath.path_of(flight, room), room)


def vehicle_log(flight: ReportedFlight) -> Figure:
    """The signal that aligned each log beside ours, ours and theirs on one time line.

    Raises RecordingError without such a log, or where it shows another flight.
    """
    paths = flight.logs_beside
    if not paths:
        raise RecordingError("no .tlog or .ulg lies beside the flight's log")
    figure = Figure(figsize=(12, 2.6 * len(paths)), layout="constrained")
    panels = figure.subplots(len(paths), 1, squeeze=False)[:, 0]
    ours = open_log(flight.path)
    for axes, path in zip(panels, paths, strict=True):
        theirs = open_log(path)
        fit = align(ours, theirs)
        one, other = signals(ours, theirs, fit)
        axes.plot(other.time_s, other.value, color="0.6", linewidth=2.0, label=path.name)
        axes.plot(one.time_s, one.value, color=COLOURS["stereo"], linewidth=0.7, label="companion")
        axes.set(
            xlim=(one.time_s[0], one.time_s[-1]), xlabel="log time, s", ylabel=AXIS[fit.signal]
        )
        axes.set_title(_told(path.name, fit), fontsize=10)
        axes.legend(loc="upper right", fontsize=8)
    return figure


def _told(name: str, fit: Alignment) -> str:
    return f"{name}: its clock {fit.offset_s:+.3f} s to ours, correlation {fit.correlation:.3f}"
