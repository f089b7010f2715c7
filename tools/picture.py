"""One flight as one picture: its path over the room, and what each eye saw of the distance.

python -m tools.picture LOG/flight.mcap --room flightplans/rooms/room1.toml
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from companion.kernel.errors import EXIT_FLOWN, CompanionError
from sitl.arena.room import Room, load_room
from tools.drawing import COLOURS, PHASES, draw_room, label_plan
from tools.flown import FlownFlight


def draw(flight: FlownFlight, room: Room | None) -> Figure:
    """Paths by phase on top, λ of both cues over time below. Raises RecordingError."""
    figure = Figure(figsize=(12, 8.5), layout="constrained")
    (upper,), (lower,) = figure.subfigures(2, 1, squeeze=False, height_ratios=(1.3, 1))
    panels = upper.subplots(1, len(PHASES), sharex=True, sharey=True)
    for axes, phase in zip(panels, PHASES, strict=True):
        _draw_path(axes, flight, flight.in_phase(phase))
        axes.set_title(_title(flight, phase), fontsize=11)
        if room is not None:
            draw_room(axes, room)
    _draw_disparity(lower.subplots(), flight)
    return figure


def _draw_path(axes: Axes, flight: FlownFlight, shown: NDArray[np.bool_]) -> None:
    decision = flight.decision
    override = decision["override"].astype(bool)
    groups = {
        "stereo": shown & (decision["cue"] == "stereo") & ~override,
        "mono": shown & (decision["cue"] == "mono"),
        "override": shown & override,
    }
    north_m, east_m = flight.places_m.T
    for name, chosen in groups.items():
        size = 14 if name == "override" else 4
        axes.scatter(east_m[chosen], north_m[chosen], s=size, color=COLOURS[name], linewidths=0)
    label_plan(axes)


def _title(flight: FlownFlight, phase: str) -> str:
    last = np.flatnonzero(flight.in_phase(phase))[-1:]
    if not len(last):
        return f"{phase}: not flown"
    counts = (int(flight.decision[name][last[0]]) for name in ("turns", "overrides"))
    return "{}: {} turns, {} overrides".format(phase, *counts)


def _draw_disparity(axes: Axes, flight: FlownFlight) -> None:
    decision, percept, time_s = flight.decision, flight.percept, flight.time_s
    axes.plot(time_s, percept["stereo_px"], color=COLOURS["stereo"], linewidth=0.7, label="stereo")
    axes.plot(time_s, percept["mono_px"], color=COLOURS["mono"], linewidth=0.7, label="mono")
    axes.plot(time_s, decision["threshold_px"], color="0.3", linewidth=0.7, label="threshold")
    override = np.flatnonzero(decision["override"])
    top_px = float(np.nanpercentile(percept["stereo_px"], 99.5))
    marks = np.full(len(override), top_px)
    axes.plot(time_s[override], marks, "|", color=COLOURS["override"], label="override")
    for phase in PHASES[1:]:
        begins = np.flatnonzero(flight.in_phase(phase))[:1]
        if len(begins):
            axes.axvline(time_s[begins[0]], color="0.6", linestyle="--", linewidth=1)
    axes.set(xlabel="time, s", ylabel="average disparity λ, px", ylim=(0, 1.05 * top_px))
    axes.set_xlim(0, time_s[-1])
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, frameon=False)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tools.picture", description=__doc__)
    parser.add_argument("log", type=Path, help="flight.mcap")
    parser.add_argument("--room", type=Path, help="TOML file of the room, to draw its walls")
    parser.add_argument("--out", type=Path, help="PNG or SVG to write; default: beside the log")
    args = parser.parse_args(argv)
    out = args.out or args.log.with_suffix(".png")
    mpl.rcParams["svg.hashsalt"] = "flight"  # the same flight gives the same file
    try:
        room = load_room(args.room) if args.room else None
        draw(FlownFlight(args.log), room).savefig(out, dpi=110)
    except CompanionError as error:
        print(f"picture: {error}", file=sys.stderr)
        return error.exit_code
    except (OSError, ValueError) as error:
        print(f"picture: {out}: cannot be written: {error}", file=sys.stderr)
        return 1
    print(out)
    return EXIT_FLOWN


if __name__ == "__main__":
    sys.exit(main())
