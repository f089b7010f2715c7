"""What happens between the hull and the room: clearance, push, bumps, crashes.

The indoor hull is taken as a ball around the centre of mass: foam that springs back. The floor is
not part of it, because the feet stand on it (see the aircraft's ground reactions).
"""

import math
from typing import Final, Protocol

from companion.kernel.frames import Vector3

HULL_RADIUS_M: Final = 0.26  # half the hull's diagonal extent of 0.52 m (Parrot's data sheet)
CRASH_SPEED_M_S: Final = 1.0  # faster than this, foam does not help
CONTACT_OVER_M: Final = 0.05  # a contact ends, and the next can begin, this far away
# A hull of 0.46 kg at 1 m/s goes in by 3 cm and comes back with a third of its speed: estimates.
_STIFFNESS_N_M: Final = 500.0
_DAMPING_N_S_M: Final = 10.0
_FRICTION_NORM: Final = 0.3
_SLIDE_M_S: Final = 0.05  # slower than this, friction fades, so that it cannot tremble

NO_FORCE: Final[Vector3] = (0.0, 0.0, 0.0)


class Surfaces(Protocol):
    """Where walls, ceiling and furniture are."""

    def nearest(self, position_ned_m: Vector3) -> tuple[float, Vector3]:
        """Distance to the nearest surface, negative inside, and the normal from it to the point."""
        ...


class ContactCounter:
    """Counts contacts once each; tells how fast each began."""

    def __init__(self) -> None:
        self.count = 0
        self.touching = False

    def update(self, clearance_m: float) -> bool:
        """Whether a contact begins now."""
        if self.touching:
            self.touching = clearance_m <= CONTACT_OVER_M
            return False
        self.touching = clearance_m <= 0.0
        self.count += self.touching
        return self.touching


def push_ned_n(clearance_m: float, normal: Vector3, velocity_ned_m_s: Vector3) -> Vector3:
    """Force of a surface on the hull: spring and damper along the normal, friction across it."""
    if clearance_m >= 0.0:
        return NO_FORCE
    v_north, v_east, v_down = velocity_ned_m_s
    n_north, n_east, n_down = normal
    leaving_m_s = v_north * n_north + v_east * n_east + v_down * n_down
    press_n = max(0.0, -_STIFFNESS_N_M * clearance_m - _DAMPING_N_S_M * leaving_m_s)
    s_north = v_north - leaving_m_s * n_north
    s_east = v_east - leaving_m_s * n_east
    s_down = v_down - leaving_m_s * n_down
    slide_m_s = math.sqrt(s_north * s_north + s_east * s_east + s_down * s_down)
    drag = _FRICTION_NORM * press_n / max(slide_m_s, _SLIDE_M_S)
    return (
        press_n * n_north - drag * s_north,
        press_n * n_east - drag * s_east,
        press_n * n_down - drag * s_down,
    )


def approach_speed_m_s(normal: Vector3, velocity_ned_m_s: Vector3) -> float:
    """Speed towards the surface."""
    v_north, v_east, v_down = velocity_ned_m_s
    return -(v_north * normal[0] + v_east * normal[1] + v_down * normal[2])
