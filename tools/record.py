"""Makes a recording in the EuRoC/ASL layout from a camera, a frame server or a flight log.

python -m tools.record tcp://127.0.0.1:14590 --out DIR --pairs 500
python -m tools.record LOG/flight.mcap --out DIR --every 10
"""

import argparse
import asyncio
import csv
import sys
from collections.abc import Sequence
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
    count = 0
    async with open_camera(source, WallClock()) as camera:
        writer = AslWriter(folder, camera.calibration)
        async with aclosing(camera.frames()) as frames:
            number = 0
            async for frame in frames:
                if number % every == 0:
                    writer.write(frame)
                    count += 1
                number += 1
                if pairs is not None and count >= pairs:
                    break
    return count


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.record",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("source", help="what --camera of companion fly takes, or a recording")
    parser.add_argument("--out", type=Path, required=True, help="new folder")
    parser.add_argument("--pairs", type=int, help="stop after so many; default: all there are")
    parser.add_argument("--every", type=int, default=1, help="keep one pair of so many")
    args = parser.parse_args(argv)
    if args.every < 1 or (args.pairs is not None and args.pairs < 1):
        parser.error("--every and --pairs must be at least 1")
    try:
        count = asyncio.run(record(args.source, args.out, args.pairs, args.every))
    except CompanionError as error:
        print(f"record: {error}", file=sys.stderr)
        return error.exit_code
    except OSError as error:
        print(f"record: {args.out}: cannot be written: {error.strerror}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"record: stopped; {args.out} holds what came", file=sys.stderr)
        return 1
    print(f"{args.out}: {count} pairs")
    return EXIT_FLOWN


if __name__ == "__main__":
    sys.exit(main())
