"""Where the flight began, or where home was said to be since."""

from typing import Final

from companion.kernel.frames import Vector3

FARTHEST_M: Final = 10_000.0  # from the start: beyond it a flat Earth is wrong


class Home:
    """Heights, the fence and the way back count from here; local positions from the start."""

    def __init__(self, yaw_rad: float) -> None:
        self.position_ned_m: Vector3 = (0.0, 0.0, 0.0)
        self.yaw_rad = yaw_rad

    def move(self, position_ned_m: Vector3, yaw_rad: float) -> bool:
        """False, and no change, for a place that nobody can fly to."""
        if not all(abs(axis) <= FARTHEST_M for axis in position_ned_m):  # NaN is none either
            return False
        self.position_ned_m, self.yaw_rad = position_ned_m, yaw_rad
        return True

    def offset_ned_m(self, position_ned_m: Vector3) -> Vector3:
        """A local position as seen from home."""
        north, east, down = position_ned_m
        home_north, home_east, home_down = self.position_ned_m
        return north - home_north, east - home_east, down - home_down
