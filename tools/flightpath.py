"""A flight's path six times over, coloured by what each cue saw of the distance.

python -m tools.flightpath LOG/flight.mcap [--out STEM] [--phase all|initial|learning|test]

The paper's flight-path figure: A λ in theory, from the true pose, the walls and the field of view;
B stereo's λ; C mono's; D their difference; E and F the difference where mono flew and gave a false
positive or a false negative. Approaches are numbered where they begin. Writes STEM.png, .svg, .csv.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from companion.kernel.settings import convert_settings
from sitl.arena.camera import StereoCameraModel, mean_disparity_px
from sitl.arena.room import Room
from sitl.settings import SitlSettings
from tools.drawing import PHASES, draw_room, label_plan, run, save_figure, save_table
from tools.flown import FlownFlight

PERCENTILES_SHOWN = (1.0, 99.0)
"""Where the colour scales end."""


Values = NDArray[np.float64]


class FlightPath(NamedTuple):
    """Per frame, all (n_frames,) but place_m (n_frames, 2), north and east; λ in pixels.

    approach: number of the approach or of the turn after it. straight: not turning. mono: mono
    flew. positive, detected: what stereo and mono said of the obstacle; False where λ is unknown.
    """

    time_s: Values
    place_m: Values
    approach: NDArray[np.int64]
    straight: NDArray[np.bool_]
    theory_px: Values
    stereo_px: Values
    mono_px: Values
    mono: NDArray[np.bool_]
    positive: NDArray[np.bool_]
    detected: NDArray[np.bool_]

    @property
    def error_px(self) -> Values:
        return np.abs(self.mono_px - self.stereo_px)


def theoretical_disparity_px(flight: FlownFlight, room: Room) -> Values:
    """(n_frames,): the average of a perfect left eye. Raises RecordingError without truth."""
    truth = flight.truth
    settings = convert_settings(dict(flight.plan.sitl), SitlSettings, f"{flight.path}: sitl")
    eye = StereoCameraModel(room, settings.camera, np.random.default_rng(flight.plan.seed))
    rotations = Rotation.from_quat(np.roll(truth["truth_ned_from_frd"], -1, axis=1)).as_matrix()
    poses = zip(truth["truth_position_ned_m"], rotations, strict=True)
    return np.array([mean_disparity_px(eye.depth(*pose), eye.calibration) for pose in poses])


def path_of(flight: FlownFlight, room: Room, phase: str = "all") -> FlightPath:
    """Raises RecordingError for a log without truth."""
    decision, percept = flight.decision, flight.percept
    thresholds_px = {name: flight.mono_threshold_px(name) for name in np.unique(decision["phase"])}
    threshold_px = np.array([thresholds_px[name] for name in decision["phase"]])
    added_px = flight.plan.learner.caution_std * np.nan_to_num(percept["mono_std_px"])
    whole = FlightPath(
        time_s=flight.time_s,
        place_m=flight.places_m,
        approach=flight.approach,
        straight=decision["state"] == "straight",
        theory_px=theoretical_disparity_px(flight, room),
        stereo_px=percept["stereo_px"],
        mono_px=percept["mono_px"],
        mono=decision["cue"] == "mono",
        positive=percept["stereo_px"] > flight.plan.behaviour.turn_threshold_px,
        detected=percept["mono_px"] + added_px > threshold_px,
    )
    shown = flight.in_phase(phase)
    return whole._replace(**{name: values[shown] for name, values in whole._asdict().items()})


class Panel(NamedTuple):
    """One path, coloured; ``scale_px`` is what the ends of the colours mean."""

    title: str
    value_px: Values
    shown: NDArray[np.bool_]
    colours: str
    scale_px: tuple[float, float]
    numbered: bool = False


def draw(path: FlightPath, room: Room) -> Figure:
    """The six panels."""
    figure = Figure(figsize=(15, 9.5), layout="constrained")
    grid = figure.subplots(2, 3, sharex=True, sharey=True)
    for axes, panel in zip(grid.flat, panels_of(path), strict=True):
        draw_room(axes, room)
        axes.plot(path.place_m[:, 1], path.place_m[:, 0], color="0.85", linewidth=0.5, zorder=0)
        north_m, east_m = path.place_m[panel.shown].T
        low_px, high_px = panel.scale_px
        dots = axes.scatter(
            east_m,
            north_m,
            c=panel.value_px[panel.shown],
            s=7,
            cmap=panel.colours,
            vmin=low_px,
            vmax=high_px,
            linewidths=0,
            rasterized=True,
        )
        figure.colorbar(dots, ax=axes, shrink=0.75, label="px", extend="max")
        if panel.numbered:
            _number(axes, path, panel.shown)
        axes.set_title(panel.title, fontsize=10)
        label_plan(axes)
    return figure


def panels_of(path: FlightPath) -> tuple[Panel, ...]:
    """A to C share a scale, D to F another; those of straight flight: turns point at walls."""
    known = ~np.isnan(path.error_px)
    flown = path.mono & known
    false_positive = flown & ~path.positive & path.detected
    false_negative = flown & path.positive & ~path.detected
    everywhere = np.ones(len(path.time_s), bool)
    ahead = [cue_px[path.straight] for cue_px in (path.theory_px, path.stereo_px, path.mono_px)]
    lambdas = "viridis", _scale(np.concatenate(ahead))
    errors = "jet", (0.0, _scale(path.error_px[path.straight])[1])
    return (
        Panel("A  λ in theory", path.theory_px, everywhere, *lambdas, numbered=True),
        Panel("B  stereo's λ", path.stereo_px, everywhere, *lambdas),
        Panel("C  mono's λ", path.mono_px, everywhere, *lambdas),
        Panel("D  error |C - B|", path.error_px, known, *errors),
        Panel("E  error in false positives", path.error_px, false_positive, *errors, True),
        Panel("F  error in false negatives", path.error_px, false_negative, *errors, True),
    )


def _scale(value_px: Values) -> tuple[float, float]:
    """Few extreme frames must not flatten all others."""
    known = value_px[~np.isnan(value_px)]
    if not len(known):
        return 0.0, 1.0
    low_px, high_px = np.percentile(known, PERCENTILES_SHOWN)
    return float(low_px), float(high_px)


def _number(axes: Axes, path: FlightPath, shown: NDArray[np.bool_]) -> None:
    """Approaches with a shown frame, at their first frame of all."""
    numbers, first = np.unique(path.approach, return_index=True)
    halo = [withStroke(linewidth=1.5, foreground="white")]
    for number in np.intersect1d(numbers, path.approach[shown]):
        north_m, east_m = path.place_m[first[numbers == number][0]]
        axes.annotate(str(number), (east_m, north_m), fontsize=6, path_effects=halo)


def write(path: FlightPath, room: Room, stem: Path) -> Iterator[Path]:
    """The figure and its data."""
    yield from save_figure(draw(path, room), stem)
    header = ("time_s", "north_m", "east_m", *path._fields[2:])
    columns = (path.time_s, *path.place_m.T, *path[2:])
    rows = zip(*(column.tolist() for column in columns), strict=True)
    yield save_table(stem.with_name(f"{stem.name}.csv"), header, rows)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.flightpath",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("log", type=Path, help="flight.mcap, with motion capture")
    parser.add_argument("--out", type=Path, help="without suffix; default: flightpath by the log")
    parser.add_argument("--phase", choices=("all", *PHASES), default="all")
    parser.add_argument("--room", type=Path, help="room file; default: the shipped one of the name")
    args = parser.parse_args(argv)

    def work() -> Iterator[Path]:
        flight = FlownFlight(args.log)
        room = flight.load_room(args.room)
        path = path_of(flight, room, args.phase)
        yield from write(path, room, args.out or args.log.with_name("flightpath"))

    return run("flightpath", work)


if __name__ == "__main__":
    sys.exit(main())
