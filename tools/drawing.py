"""What the figure tools share: rooms and colours drawn alike, files written alike."""

import csv
import sys
from collections.abc import Callable, Iterable, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from companion.kernel.errors import EXIT_FAILED, EXIT_FLOWN, CompanionError
from sitl.arena.room import Room

COLOURS = {"stereo": "#0072b2", "mono": "#009e73", "override": "#d55e00"}
"""Wong's palette: told apart by colour-blind readers too."""
PALETTE = ("#0072b2", "#009e73", "#d55e00", "#cc79a7", "#e69f00", "#56b4e9")
"""The same, for what has no colour of its own."""
PHASES = ("initial", "learning", "test")


def colours_of(names: Iterable[str]) -> dict[str, str]:
    """From the palette, which begins anew after its last."""
    return dict(zip(names, cycle(PALETTE), strict=False))


def draw_room(axes: Axes, room: Room) -> None:
    """Walls and furniture from above, east to the right, north up."""
    low_m, high_m = room.bounds_ned_m[:, :2]
    size_m = high_m - low_m
    axes.add_patch(Rectangle((low_m[1], low_m[0]), size_m[1], size_m[0], fill=False, linewidth=2))
    for north_0, east_0, _, north_1, east_1, _ in room.boxes_ned_m:
        box = Rectangle((east_0, north_0), east_1 - east_0, north_1 - north_0, color="0.7")
        axes.add_patch(box)
    for north_m, east_m, radius_m, _, _ in room.cylinders_ned_m:
        axes.add_patch(Circle((east_m, north_m), radius_m, color="0.7"))


def label_plan(axes: Axes) -> None:
    """Axes of a plan view, the same scale on both."""
    axes.set_aspect("equal")
    axes.set(xlabel="east, m", ylabel="north, m")
    axes.label_outer()


def save_figure(figure: Figure, stem: Path, dpi: int = 110) -> list[Path]:
    """PNG and SVG; the same figure gives the same files."""
    mpl.rcParams["svg.hashsalt"] = "flight"
    paths = [stem.with_name(f"{stem.name}.{kind}") for kind in ("png", "svg")]
    figure.savefig(paths[0], dpi=dpi)
    figure.savefig(paths[1], dpi=dpi, metadata={"Date": None})
    return paths


def save_table(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> Path:
    """CSV; NaN is an empty cell."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows([_cell(value) for value in row] for row in rows)
    return path


def _cell(value: object) -> object:
    if isinstance(value, float | np.floating):
        return "" if np.isnan(value) else f"{value:.6g}"
    return value


def run(tool: str, work: Callable[[], Iterable[object]]) -> int:
    """Does a tool's work and prints what it made; an error is one line on stderr."""
    try:
        for line in work():
            print(line)
    except CompanionError as error:
        print(f"{tool}: {error}", file=sys.stderr)
        return error.exit_code
    except OSError as error:
        print(f"{tool}: {error.filename}: {error.strerror}", file=sys.stderr)
        return EXIT_FAILED
    return EXIT_FLOWN
