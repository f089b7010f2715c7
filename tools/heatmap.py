"""Where flights were: time spent per cell of the room, in approaches and in turns.

python -m tools.heatmap LOGS ... --out DIR [--phase all|initial|learning|test] [--cell-m 0.25]

One figure per room: turns above, approaches below, for each scheme and cue that flew, as in the
paper's heat maps. Writes heatmap-ROOM.png, .svg and .csv (seconds per cell).
"""

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sitl.arena.room import Room
from tools.drawing import PHASES, draw_room, label_plan, run, save_figure, save_table
from tools.flown import FlownFlight, find_logs
from tools.progress import watched

MANOEUVRES = ("turn", "approach")
CELL_M = 0.25
PAIRS_ABREAST = 4
"""Of scheme and cue; more would be too small on a page."""


class Grid(NamedTuple):
    """Edges of the cells over a room, metres in NED: (n_north + 1,), (n_east + 1,)."""

    north_m: NDArray[np.float64]
    east_m: NDArray[np.float64]


class Heat(NamedTuple):
    """Seconds per cell, (n_north, n_east), of the flights of one scheme on one cue."""

    scheme: str
    cue: str
    manoeuvre: str
    flights: int
    duration_s: NDArray[np.float64]


def grid_over(room: Room, cell_m: float) -> Grid:
    low_m, high_m = room.bounds_ned_m[:, :2]
    counts = np.maximum(1, np.round((high_m - low_m) / cell_m).astype(int))
    return Grid(*(np.linspace(low_m[i], high_m[i], counts[i] + 1) for i in (0, 1)))


def heat_of(flights: Sequence[FlownFlight], grid: Grid, phase: str = "all") -> list[Heat]:
    """Per scheme and cue that flew in ``phase``; what lies outside the room does not count."""
    schemes = list(dict.fromkeys(flight.plan.experiment.scheme for flight in flights))
    heats = []
    for scheme in schemes:
        chosen = [flight for flight in flights if flight.plan.experiment.scheme == scheme]
        for cue in ("stereo", "mono"):
            pair = [_heat(chosen, grid, phase, cue, manoeuvre) for manoeuvre in MANOEUVRES]
            if any(heat.duration_s.any() for heat in pair):
                heats += pair
    return heats


def _heat(flights: Sequence[FlownFlight], grid: Grid, phase: str, cue: str, manoeuvre: str) -> Heat:
    duration_s = np.zeros((len(grid.north_m) - 1, len(grid.east_m) - 1))
    for flight in flights:
        straight = flight.decision["state"] == "straight"
        shown = flight.in_phase(phase) & (flight.decision["cue"] == cue)
        shown &= straight == (manoeuvre == "approach")
        north_m, east_m = flight.places_m[shown].T
        counts, _, _ = np.histogram2d(north_m, east_m, bins=grid)
        duration_s += counts / flight.plan.camera.rate_hz
    return Heat(flights[0].plan.experiment.scheme, cue, manoeuvre, len(flights), duration_s)


def draw(heats: Sequence[Heat], grid: Grid, room: Room) -> Figure:
    """Each panel on its own scale: shapes are compared, not times."""
    pairs = list(dict.fromkeys((heat.scheme, heat.cue) for heat in heats))
    columns, bands = min(len(pairs), PAIRS_ABREAST), math.ceil(len(pairs) / PAIRS_ABREAST)
    figure = Figure(figsize=(1.0 + 3.0 * columns, 0.5 + 3.2 * 2 * bands), layout="constrained")
    panels = figure.subplots(2 * bands, columns, sharex=True, sharey=True, squeeze=False)
    extent = (grid.east_m[0], grid.east_m[-1], grid.north_m[0], grid.north_m[-1])
    for axes in panels.flat:
        axes.set_axis_off()
    for heat in heats:
        band, column = divmod(pairs.index((heat.scheme, heat.cue)), PAIRS_ABREAST)
        axes = panels[2 * band + MANOEUVRES.index(heat.manoeuvre), column]
        axes.set_axis_on()
        _draw_panel(axes, heat, extent)
        draw_room(axes, room)
        label_plan(axes)
    return figure


def _draw_panel(axes: Axes, heat: Heat, extent: tuple[float, float, float, float]) -> None:
    """The brightest are the hundredth of the cells where most time was spent: all flights begin
    alike, and the few cells of that beginning would outshine all others."""
    visited_s = heat.duration_s[heat.duration_s > 0]
    brightest_s = float(np.percentile(visited_s, 99)) if len(visited_s) else 1.0
    axes.imshow(
        heat.duration_s, origin="lower", extent=extent, cmap="inferno", vmin=0, vmax=brightest_s
    )
    name = heat.scheme.replace("_", " ")
    told = (
        f"{heat.manoeuvre}: {heat.duration_s.sum():.0f} s, brightest ≥ {brightest_s:.1f} s a cell"
    )
    axes.set_title(f"{name}, {heat.cue}\n{told}", fontsize=9)


def write(
    flights: Sequence[FlownFlight],
    folder: Path,
    phase: str = "all",
    cell_m: float = CELL_M,
    room_path: Path | None = None,
) -> Iterator[Path]:
    """Figure and data of each room that the flights were in."""
    folder.mkdir(parents=True, exist_ok=True)
    header = ("scheme", "cue", "manoeuvre", "flights", "north_m", "east_m", "duration_s")
    for name in sorted({flight.room_name for flight in flights}):
        here = [flight for flight in flights if flight.room_name == name]
        room = here[0].load_room(room_path)
        grid = grid_over(room, cell_m)
        heats = heat_of(here, grid, phase)
        stem = folder / f"heatmap-{name}"
        if heats:
            yield from save_figure(draw(heats, grid, room), stem)
        yield save_table(stem.with_suffix(".csv"), header, _rows(heats, grid))


def _rows(heats: Sequence[Heat], grid: Grid) -> Iterator[tuple[object, ...]]:
    """Cells that were visited, by their centre."""
    north_m, east_m = ((edges[1:] + edges[:-1]) / 2 for edges in grid)
    for heat in heats:
        for row, column in np.argwhere(heat.duration_s > 0):
            place = (float(north_m[row]), float(east_m[column]))
            yield *heat[:4], *place, float(heat.duration_s[row, column])


def _read(path: Path) -> FlownFlight:
    flight = FlownFlight(path)
    _ = flight.places_m  # here, where it is seen how far reading has come
    return flight


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.heatmap",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("logs", type=Path, nargs="+", help="flights, or folders that hold them")
    parser.add_argument("--out", type=Path, required=True, help="folder to write to")
    parser.add_argument("--phase", choices=("all", *PHASES), default="all")
    parser.add_argument("--cell-m", type=float, default=CELL_M, help="side of a cell")
    parser.add_argument("--room", type=Path, help="room file; default: the shipped one of the name")
    args = parser.parse_args(argv)
    if not args.cell_m > 0:
        parser.error("--cell-m must be above 0")

    def work() -> Iterator[Path]:
        flights = [_read(path) for path in watched(find_logs(args.logs), "flights")]
        yield from write(flights, args.out, args.phase, args.cell_m, args.room)

    return run("heatmap", work)


if __name__ == "__main__":
    sys.exit(main())
