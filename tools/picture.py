"""One flight as one picture: its path over the room, and what each eye saw of the distance.

python -m tools.picture LOG/flight.mcap --room flightplans/rooms/room1.toml
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from numpy.typing import NDArray

from companion.flightlog import FlightLog, Topic
from companion.kernel.errors import EXIT_FLOWN, CompanionError, RecordingError
from sitl.arena.room import Room, load_room

COLOURS = {"stereo": "#0072b2", "mono": "#009e73", "override": "#d55e00"}
"""Wong's palette: told apart by colour-blind readers too."""
PHASES = ("initial", "learning", "test")

Columns = dict[str, NDArray[Any]]


def draw(log: FlightLog, room: Room | None) -> Figure:
    """Paths by phase on top, λ of both cues over time below. Raises RecordingError."""
    decision, percept = _together(log.columns(Topic.DECISION), log.columns(Topic.PERCEPT))
    if not len(decision["stamp_ns"]):
        raise RecordingError(f"{log.path}: nothing was flown")
    figure = Figure(figsize=(12, 8.5), layout="constrained")
    upper, lower = figure.subfigures(2, 1, height_ratios=(1.3, 1))
    panels = upper.subplots(1, len(PHASES), sharex=True, sharey=True)
    north_m, east_m = _places(log, decision)
    for axes, phase in zip(panels, PHASES, strict=True):
        _draw_path(axes, north_m, east_m, decision, decision["phase"] == phase)
        axes.set_title(_title(decision, phase), fontsize=11)
        if room is not None:
            _draw_room(axes, room)
    _draw_disparity(lower.subplots(), decision, percept)
    return figure


def _together(*tables: Columns) -> tuple[Columns, ...]:
    """The records of the same frames; a log that was cut off may miss the last of one topic."""
    count = min(len(table["stamp_ns"]) for table in tables)
    return tuple({name: column[:count] for name, column in table.items()} for table in tables)


def _places(log: FlightLog, decision: Columns) -> tuple[NDArray[Any], NDArray[Any]]:
    """(north, east) at each decision: the truth where it is known, else the estimate."""
    if Topic.MOCAP in log.topics():
        mocap = log.columns(Topic.MOCAP)
        stamps, places = mocap["stamp_ns"], mocap["truth_position_ned_m"]
        return tuple(np.interp(decision["stamp_ns"], stamps, places[:, i]) for i in (0, 1))  # type: ignore[return-value]
    places = log.columns(Topic.TELEMETRY)["position_ned_m"]
    return places[:, 0], places[:, 1]


def _draw_path(
    axes: Axes,
    north_m: NDArray[Any],
    east_m: NDArray[Any],
    decision: Columns,
    shown: NDArray[np.bool_],
) -> None:
    override = decision["override"].astype(bool)
    groups = {
        "stereo": shown & (decision["cue"] == "stereo") & ~override,
        "mono": shown & (decision["cue"] == "mono"),
        "override": shown & override,
    }
    for name, chosen in groups.items():
        size = 14 if name == "override" else 4
        axes.scatter(east_m[chosen], north_m[chosen], s=size, color=COLOURS[name], linewidths=0)
    axes.set_aspect("equal")
    axes.set(xlabel="east, m", ylabel="north, m")
    axes.label_outer()


def _title(decision: Columns, phase: str) -> str:
    last = np.flatnonzero(decision["phase"] == phase)[-1:]
    if not len(last):
        return f"{phase}: not flown"
    counts = (int(decision[name][last[0]]) for name in ("turns", "overrides"))
    return "{}: {} turns, {} overrides".format(phase, *counts)


def _draw_room(axes: Axes, room: Room) -> None:
    low_m, high_m = room.bounds_ned_m[:, :2]
    size_m = high_m - low_m
    axes.add_patch(Rectangle((low_m[1], low_m[0]), size_m[1], size_m[0], fill=False, linewidth=2))
    for north_0, east_0, _, north_1, east_1, _ in room.boxes_ned_m:
        box = Rectangle((east_0, north_0), east_1 - east_0, north_1 - north_0, color="0.7")
        axes.add_patch(box)
    for north_m, east_m, radius_m, _, _ in room.cylinders_ned_m:
        axes.add_patch(Circle((east_m, north_m), radius_m, color="0.7"))


def _draw_disparity(axes: Axes, decision: Columns, percept: Columns) -> None:
    time_s = (percept["stamp_ns"] - percept["stamp_ns"][0]) * 1e-9
    axes.plot(time_s, percept["stereo_px"], color=COLOURS["stereo"], linewidth=0.7, label="stereo")
    axes.plot(time_s, percept["mono_px"], color=COLOURS["mono"], linewidth=0.7, label="mono")
    axes.plot(time_s, decision["threshold_px"], color="0.3", linewidth=0.7, label="threshold")
    override = np.flatnonzero(decision["override"])
    top_px = float(np.nanpercentile(percept["stereo_px"], 99.5))
    marks = np.full(len(override), top_px)
    axes.plot(time_s[override], marks, "|", color=COLOURS["override"], label="override")
    for phase in PHASES[1:]:
        begins = np.flatnonzero(decision["phase"] == phase)[:1]
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
        draw(FlightLog(args.log), load_room(args.room) if args.room else None).savefig(out, dpi=110)
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
