"""A learned texton dictionary as pictures, and a flight as the learner saw it.

python -m tools.textons LOG_DIR/model.npz [--out STEM]
python -m tools.textons LOG_DIR/flight.mcap [--every 5] [--first-s 0] [--last-s 30] [--out STEM]

A model gives STEM.png, .svg and .csv: intensity textons in grey, gradient textons from blue (low)
to red (high). A flight that logged images (``log.images = "stereo"``) gives an animated STEM.png
with the image, its nearest textons and their histogram, and STEM.csv with the histograms.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from companion.camera.logged import LoggedRecording
from companion.kernel.errors import PlanError
from companion.learning.learner import Learner
from companion.memory import MODEL_NAME
from companion.modelfile import load_dictionary
from companion.vision.textons import MID_GREY, TextonDictionary, gradient_matrix, grid_places
from tools.drawing import run, save_figure, save_table
from tools.flown import FlownFlight

KINDS = ("intensity", "gradient")
ZOOM = 3
RIM_PX = 12

Colours = NDArray[np.uint8]


def draw_dictionary(dictionary: TextonDictionary) -> Figure:
    """One row per kind, in the order of the Kohonen map."""
    columns = max(len(textons) for textons in dictionary)
    figure = Figure(figsize=(1.0 * columns, 2.6), layout="constrained")
    panels = figure.subplots(2, columns, squeeze=False)
    for axes in panels.flat:
        axes.axis("off")
    side = round(np.sqrt(dictionary.intensity.shape[1]))
    steepest = float(np.abs(dictionary.gradient).max()) or 1.0
    scales = {
        "intensity": {"cmap": "gray", "vmin": -MID_GREY, "vmax": 255 - MID_GREY},
        "gradient": {"cmap": "jet", "vmin": -steepest, "vmax": steepest},
    }
    for row, (kind, textons) in enumerate(dictionary._asdict().items()):
        panels[row, 0].set_title(kind, fontsize=9, loc="left")
        for axes, texton in zip(panels[row], textons, strict=False):
            axes.imshow(texton.reshape(side, side), **scales[kind])
    return figure


def write_dictionary(dictionary: TextonDictionary, stem: Path) -> Iterator[Path]:
    """The figure, and one row per texton: its values, row by row of the patch."""
    yield from save_figure(draw_dictionary(dictionary), stem)
    n_values = dictionary.intensity.shape[1]
    header = ("kind", "texton", *(f"value_{index}" for index in range(n_values)))
    rows = (
        (kind, number, *texton.tolist())
        for kind in KINDS
        for number, texton in enumerate(getattr(dictionary, kind))
    )
    yield save_table(stem.with_name(f"{stem.name}.csv"), header, rows)


def nearest_textons(
    image: NDArray[np.uint8], dictionary: TextonDictionary, places: NDArray[np.int64]
) -> NDArray[np.int64]:
    """(2, n_places): the nearest intensity and gradient texton of the patch at each place."""
    side = round(np.sqrt(dictionary.intensity.shape[1]))
    windows = np.lib.stride_tricks.sliding_window_view(image, (side, side))
    patches = windows[places[:, 0], places[:, 1]].reshape(len(places), -1) - MID_GREY
    samples = patches, patches @ gradient_matrix(side).T
    return np.stack(
        [
            np.square(sample[:, None] - textons).sum(axis=-1).argmin(axis=1)
            for sample, textons in zip(samples, dictionary, strict=True)
        ]
    )


def histogram(nearest: NDArray[np.int64], dictionary: TextonDictionary) -> NDArray[np.float64]:
    """(n_textons,): the learner's, each half sums to 0.5."""
    halves = [
        np.bincount(row, minlength=len(textons)) / (2.0 * len(row))
        for row, textons in zip(nearest, dictionary, strict=True)
    ]
    return np.concatenate(halves)


class Shot(NamedTuple):
    """One frame of the animation. image: (height, width); nearest: (2, n_places)."""

    time_s: float
    image: NDArray[np.uint8]
    nearest: NDArray[np.int64]
    stereo_px: float
    mono_px: float
    threshold_px: float


def shots_of(
    flight: FlownFlight, dictionary: TextonDictionary, every: int, first_s: float, last_s: float
) -> Iterator[Shot]:
    """Every ``every``-th frame between two times of the flight. Raises RecordingError."""
    learner = Learner(flight.plan.learner, np.random.default_rng(0), dictionary)
    settings = flight.plan.learner.textons
    recording = LoggedRecording(flight.path)
    for number, frame in enumerate(recording):
        if number >= len(flight.time_s) or flight.time_s[number] > last_s:
            return
        if number % every or flight.time_s[number] < first_s:
            continue
        image = learner.image_of(frame)
        places = grid_places(image.shape, settings.patch_px, settings.patches)
        yield Shot(
            time_s=float(flight.time_s[number]),
            image=image,
            nearest=nearest_textons(image, dictionary, places),
            stereo_px=float(flight.percept["stereo_px"][number]),
            mono_px=float(flight.percept["mono_px"][number]),
            threshold_px=float(flight.decision["threshold_px"][number]),
        )


def draw_shot(shot: Shot, dictionary: TextonDictionary) -> Colours:
    """The image, the same under its intensity and gradient textons, and the histogram below."""
    size = (shot.image.shape[1] * ZOOM, shot.image.shape[0] * ZOOM)
    grey = cv2.resize(shot.image, size, interpolation=cv2.INTER_NEAREST)
    panes = [cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB)]
    colours = _colours(dictionary)
    side = round(np.sqrt(dictionary.intensity.shape[1]))
    places = grid_places(shot.image.shape, side, shot.nearest.shape[1])
    for nearest, palette in zip(shot.nearest, colours, strict=True):
        pane = panes[0] // 2
        for (row, column), texton in zip(places, nearest, strict=True):
            corner = (int(column) * ZOOM + ZOOM, int(row) * ZOOM + ZOOM)
            far = (corner[0] + (side - 2) * ZOOM, corner[1] + (side - 2) * ZOOM)
            cv2.rectangle(pane, corner, far, palette[texton].tolist(), -1)
        panes.append(pane)
    images = np.hstack(panes)
    return np.vstack([images, _bars(shot, dictionary, np.concatenate(colours), images.shape[1])])


def _colours(dictionary: TextonDictionary) -> list[Colours]:
    """A colour per texton, (n, 3): intensity from dark to bright, gradient from low to high."""
    palettes = []
    for textons, name in zip(dictionary, ("viridis", "turbo"), strict=True):
        shades = colormaps[name](np.linspace(0.05, 1.0, len(textons)))[:, :3]
        palettes.append((255 * shades).astype(np.uint8))
    return palettes


def _bars(shot: Shot, dictionary: TextonDictionary, colours: Colours, width_px: int) -> Colours:
    height_px = 8 * RIM_PX
    pane = np.full((height_px + 3 * RIM_PX, width_px, 3), 255, np.uint8)
    bar_px = (width_px - 2 * RIM_PX) // len(colours)
    for number, share in enumerate(histogram(shot.nearest, dictionary)):
        left, foot = RIM_PX + number * bar_px, height_px + RIM_PX // 2
        top = foot - round(2.0 * share * height_px)
        far = (left + bar_px - bar_px // 6, top)
        cv2.rectangle(pane, (left, foot), far, colours[number].tolist(), -1)
    text = (
        f"t {shot.time_s:5.1f} s   stereo {shot.stereo_px:4.1f} px   mono {shot.mono_px:4.1f} px   "
        f"threshold {shot.threshold_px:.1f} px"
    )
    place = (RIM_PX, height_px + 2 * RIM_PX)
    cv2.putText(pane, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 1, cv2.LINE_AA)
    return pane


def write_animation(
    shots: Sequence[Shot], dictionary: TextonDictionary, period_s: float, stem: Path
) -> Iterator[Path]:
    """An animated PNG that any browser plays, and the histogram of every shot."""
    pictures = [Image.fromarray(draw_shot(shot, dictionary)) for shot in shots]
    path = stem.with_name(f"{stem.name}.png")
    pictures[0].save(
        path, save_all=True, append_images=pictures[1:], duration=1000.0 * period_s, loop=0
    )
    yield path
    names = [f"{kind}_{n}" for kind in KINDS for n in range(len(getattr(dictionary, kind)))]
    rows = (
        (shot.time_s, shot.stereo_px, shot.mono_px, *histogram(shot.nearest, dictionary).tolist())
        for shot in shots
    )
    header = ("time_s", "stereo_px", "mono_px", *names)
    yield save_table(stem.with_name(f"{stem.name}.csv"), header, rows)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.textons",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("source", type=Path, help="model.npz, or a flight.mcap with images")
    parser.add_argument("--out", type=Path, help="without suffix; default: beside the source")
    parser.add_argument("--model", type=Path, help="of a flight; default: model.npz beside its log")
    parser.add_argument("--every", type=int, default=5, help="show one frame of so many")
    parser.add_argument("--first-s", type=float, default=0.0)
    parser.add_argument("--last-s", type=float, default=30.0)
    args = parser.parse_args(argv)
    if args.every < 1:
        parser.error("--every must be at least 1")
    stem = args.out or args.source.with_name("textons")

    def work() -> Iterator[Path]:
        if args.source.suffix == ".npz":
            yield from write_dictionary(load_dictionary(args.source), stem)
            return
        flight = FlownFlight(args.source)
        dictionary = load_dictionary(args.model or args.source.with_name(MODEL_NAME))
        shots = list(shots_of(flight, dictionary, args.every, args.first_s, args.last_s))
        if not shots:
            raise PlanError(f"{args.source}: no frame from {args.first_s:g} to {args.last_s:g} s")
        period_s = args.every / flight.plan.camera.rate_hz
        yield from write_animation(shots, dictionary, period_s, stem)

    return run("textons", work)


if __name__ == "__main__":
    sys.exit(main())
