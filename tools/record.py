"""Makes recordings in the EuRoC/ASL layout: of a camera, a frame server, a flight log or SITL.

python -m tools.record tcp://127.0.0.1:14590 --out DIR --pairs 500
python -m tools.record LOG/flight.mcap --out DIR --every 10
python -m tools.record --all DIR

The last one flies the plans room1, room2, office and corridor in lockstep and keeps what their
cameras saw as DIR/room1 and so on, 20,000 pairs; those that are there already are left alone.
"""

import argparse
import asyncio
import csv
import shutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import aclosing
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.camera.spec import open_camera
from companion.kernel.calibration import Intrinsics, StereoCalibration
from companion.kernel.clock import WallClock
from companion.kernel.errors import EXIT_FLOWN, CompanionError, PlanError
from companion.kernel.messages import StereoFrame
from tools.arguments import count
from tools.simulated import missing_logs

EYES = ("cam0", "cam1")


class AslWriter:
    """A new recording in ``folder``, which must be absent or empty. Raises PlanError."""

    def __init__(self, folder: Path, calibration: StereoCalibration) -> None:
        if folder.is_dir() and any(folder.iterdir()):
            raise PlanError(f"{folder}: not empty; a recording needs a new folder")
        self._eyes = [folder / "mav0" / eye for eye in EYES]
        for eye, text in zip(self._eyes, sensor_yamls(calibration), strict=True):
            (eye / "data").mkdir(parents=True)
            (eye / "sensor.yaml").write_text(text, encoding="utf-8")
            (eye / "data.csv").write_text("#timestamp [ns],filename\n", encoding="utf-8")

    def write(self, frame: StereoFrame) -> None:
        """Appends a pair; one that is cut off before it is listed does not count."""
        name = f"{frame.stamp_ns}.png"
        for eye, image in zip(self._eyes, (frame.left, frame.right), strict=True):
            (eye / "data" / name).write_bytes(_png(image))
        for eye in self._eyes:
            with (eye / "data.csv").open("a", newline="", encoding="utf-8") as file:
                csv.writer(file, lineterminator="\n").writerow((frame.stamp_ns, name))


def _png(image: NDArray[np.uint8]) -> bytes:
    return bytes(cv2.imencode(".png", image, (cv2.IMWRITE_PNG_COMPRESSION, 9))[1])


def sensor_yamls(calibration: StereoCalibration) -> tuple[str, str]:
    """The ``sensor.yaml`` of both eyes; the body frame is the left eye's."""
    rotation = np.array(calibration.right_from_left).reshape(3, 3)
    body_from_right = np.eye(4)
    body_from_right[:3, :3] = rotation.T
    body_from_right[:3, 3] = rotation.T @ (calibration.baseline_m, 0.0, 0.0)
    return (
        _sensor_yaml(calibration, calibration.left, np.eye(4)),
        _sensor_yaml(calibration, calibration.right, body_from_right),
    )


def _sensor_yaml(
    calibration: StereoCalibration, eye: Intrinsics, body_from_eye: NDArray[np.float64]
) -> str:
    intrinsics = [eye.focal_x_px, eye.focal_y_px, eye.centre_x_px, eye.centre_y_px]
    return (
        "sensor_type: camera\n"
        "T_BS:\n"
        "  cols: 4\n"
        "  rows: 4\n"
        f"  data: {body_from_eye.ravel().tolist()}\n"
        f"resolution: [{calibration.width_px}, {calibration.height_px}]\n"
        "camera_model: pinhole\n"
        f"intrinsics: {intrinsics}\n"
        "distortion_model: radial-tangential\n"
        f"distortion_coefficients: {list(eye.distortion)}\n"
    )


async def record(source: str, folder: Path, pairs: int | None, every: int) -> int:
    """Writes every ``every``-th pair until the source ends; returns how many were written."""
    n_written = 0
    async with open_camera(source, WallClock()) as camera:
        writer = AslWriter(folder, camera.calibration)
        async with aclosing(camera.frames()) as frames:
            number = 0
            async for frame in frames:
                if number % every == 0:
                    writer.write(frame)
                    n_written += 1
                number += 1
                if pairs is not None and n_written >= pairs:
                    break
    return n_written


def record_all(
    folder: Path, words: Sequence[str], pairs: int | None, every: int
) -> Iterator[tuple[Path, int]]:
    """Each missing simulated recording as it is done, and how many pairs it holds."""
    for name, log in missing_logs(folder, words):
        unfinished = folder / f".{name}.unfinished"
        shutil.rmtree(unfinished, ignore_errors=True)
        count = asyncio.run(record(str(log), unfinished, pairs, every))
        unfinished.rename(folder / name)
        yield folder / name, count


def main(argv: Sequence[str] | None = None) -> int:
    args = _arguments(argv)
    try:
        if args.all:
            for folder, n_pairs in record_all(args.all, args.set, args.pairs, args.every):
                print(f"{folder}: {n_pairs} pairs", flush=True)
        else:
            n_pairs = asyncio.run(record(args.source, args.out, args.pairs, args.every))
            print(f"{args.out}: {n_pairs} pairs")
    except CompanionError as error:
        print(f"record: {error}", file=sys.stderr)
        return error.exit_code
    except OSError as error:
        print(
            f"record: {args.all or args.out}: cannot be written: {error.strerror}", file=sys.stderr
        )
        return 1
    except KeyboardInterrupt:
        print(f"record: stopped; {args.all or args.out} holds what came", file=sys.stderr)
        return 1
    return EXIT_FLOWN


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m tools.record",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "source", nargs="?", help="what --camera of companion fly takes, or a recording"
    )
    goal = parser.add_mutually_exclusive_group(required=True)
    goal.add_argument("--out", type=Path, help="new folder")
    goal.add_argument("--all", type=Path, metavar="DIR", help="the simulated recordings, in here")
    parser.add_argument("--pairs", type=count, help="stop after so many; default: all there are")
    parser.add_argument("--every", type=count, default=1, help="keep one pair of so many")
    parser.add_argument(
        "--set",
        nargs="+",
        default=[],
        metavar="KEY=VALUE",
        help="with --all: override keys of the plans",
    )
    args = parser.parse_args(argv)
    if (args.source is None) != (args.all is not None):
        parser.error("give a source with --out, and none with --all")
    return args


if __name__ == "__main__":
    sys.exit(main())
