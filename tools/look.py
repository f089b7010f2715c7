"""Shows a room: what the camera sees from a place in it, how far that is, and the plan view.

python -m tools.look flightplans/rooms/office.toml --at 1 0 1.5 30 --out office.png
"""

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.kernel.errors import EXIT_FLOWN, CompanionError
from companion.kernel.frames import matrix_from_euler
from sitl.arena.camera import CameraSettings, StereoCameraModel, mean_disparity_px
from sitl.arena.room import Room, load_room

VIEW_PX = 480
RIM_PX = 16
INK, PAPER, FURNITURE, DECAL, CAMERA = 40, 255, 170, 90, 0


def look(room: Room, at: Sequence[float], seed: int = 1) -> tuple[NDArray[np.uint8], float]:
    """(left eye, depth with near being bright, plan view side by side; mean disparity, px).

    ``at``: north, east, height in metres and yaw in degrees.
    """
    north_m, east_m, height_m, yaw_deg = at
    model = StereoCameraModel(room, CameraSettings(), np.random.default_rng(seed))
    pose = ((north_m, east_m, -height_m), matrix_from_euler(0.0, 0.0, math.radians(yaw_deg)))
    left = model.render(*pose, stamp_ns=0).left
    depth_m = model.depth(*pose)
    near = (255.0 * np.sqrt(depth_m.min() / depth_m)).astype(np.uint8)
    fov_rad = math.radians(model.settings.horizontal_fov_deg)
    panes = [_fit(left), _fit(near), plan_view(room, at, fov_rad)]
    return np.hstack(panes), mean_disparity_px(depth_m, model.calibration)


def _fit(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    size = (round(VIEW_PX * image.shape[1] / image.shape[0]), VIEW_PX)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_NEAREST), np.uint8)


def plan_view(room: Room, at: Sequence[float], fov_rad: float) -> NDArray[np.uint8]:
    """The room from above, north up: furniture, what hangs on the walls, the field of view."""
    low_m, high_m = room.bounds_ned_m[:, :2]
    scale = (VIEW_PX - 2 * RIM_PX) / float(high_m[0] - low_m[0])

    def pixel(north_m: float, east_m: float) -> tuple[int, int]:
        column = RIM_PX + (east_m - low_m[1]) * scale
        return round(column), round(RIM_PX + (high_m[0] - north_m) * scale)

    width_px = round(2 * RIM_PX + float(high_m[1] - low_m[1]) * scale)
    image = np.full((VIEW_PX, width_px), PAPER, np.uint8)
    for north_0, east_0, _, north_1, east_1, _ in room.boxes_ned_m:
        cv2.rectangle(image, pixel(north_0, east_0), pixel(north_1, east_1), FURNITURE, -1)
    for north_m, east_m, radius_m, _, _ in room.cylinders_ned_m:
        cv2.circle(image, pixel(north_m, east_m), round(radius_m * scale), FURNITURE, -1)
    cv2.rectangle(image, pixel(*low_m), pixel(*high_m), INK, 2)
    for start_m, end_m in _decals(room):
        cv2.line(image, pixel(*start_m), pixel(*end_m), DECAL, 7)
    for side in (-0.5, 0.5):
        bearing_rad = math.radians(at[3]) + side * fov_rad
        tip_m = (at[0] + math.cos(bearing_rad), at[1] + math.sin(bearing_rad))
        cv2.line(image, pixel(at[0], at[1]), pixel(*tip_m), CAMERA, 1, cv2.LINE_AA)
    cv2.circle(image, pixel(at[0], at[1]), 4, CAMERA, -1, cv2.LINE_AA)
    return image


def _decals(room: Room) -> list[tuple[tuple[float, float], tuple[float, float]]]:
    """(north, east) of both ends of everything that hangs on a wall."""
    north_m, east_m, _ = (float(side_m) / 2 for side_m in room.settings.size_m)
    ends = []
    for poster in room.settings.poster:
        first_m = poster.centre_m[0] - poster.size_m[0] / 2
        last_m = poster.centre_m[0] + poster.size_m[0] / 2
        if poster.wall in ("north", "south"):
            wall_m = north_m if poster.wall == "north" else -north_m
            ends.append(((wall_m, first_m), (wall_m, last_m)))
        elif poster.wall in ("east", "west"):
            wall_m = east_m if poster.wall == "east" else -east_m
            ends.append(((first_m, wall_m), (last_m, wall_m)))
    return ends


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tools.look", description=__doc__)
    parser.add_argument("room", type=Path, help="TOML file of the room")
    place = ("NORTH", "EAST", "HEIGHT", "YAW")
    parser.add_argument(
        "--at", type=float, nargs=4, metavar=place, help="metres and degrees; default: the start"
    )
    parser.add_argument("--out", type=Path, required=True, help="PNG to write")
    args = parser.parse_args(argv)
    try:
        room = load_room(args.room)
        start = room.settings.start
        image, disparity_px = look(room, args.at or (*start.position_m, 1.2, start.yaw_deg))
    except CompanionError as error:
        print(f"look: {error}", file=sys.stderr)
        return error.exit_code
    if not cv2.imwrite(str(args.out), image):
        print(f"look: {args.out}: cannot be written", file=sys.stderr)
        return 1
    print(f"mean disparity {disparity_px:.2f} px")
    return EXIT_FLOWN


if __name__ == "__main__":
    sys.exit(main())
