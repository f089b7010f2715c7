"""A path over its room, as SVG written by hand: a failing test needs no plotting library."""

from collections.abc import Iterator, Sequence

from companion.kernel.messages import MocapPose
from sitl.arena.room import Room
from sitl.hull import HULL_RADIUS_M

PX_PER_M = 80.0
MARGIN_M = 0.3
STEP_POSES = 5
"""Every fifth pose of 100 a second is drawn."""
_FURNITURE = 'fill="#bbb"'


def draw_path(room: Room, path: Sequence[MocapPose]) -> str:
    """Seen from above, north up: where the vehicle was, where it began, where it touched."""
    (south_m, west_m), (north_m, east_m) = room.bounds_ned_m[:, :2].tolist()
    width_m, height_m = east_m - west_m + 2 * MARGIN_M, north_m - south_m + 2 * MARGIN_M
    body = "\n".join((*_room(room), *_track(path)))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" '
        f'width="{width_m * PX_PER_M:.0f}" height="{height_m * PX_PER_M:.0f}" '
        f'viewBox="{west_m - MARGIN_M:g} {-north_m - MARGIN_M:g} {width_m:g} {height_m:g}">\n'
        f'<rect x="{west_m - MARGIN_M:g}" y="{-north_m - MARGIN_M:g}" width="{width_m:g}" '
        f'height="{height_m:g}" fill="white"/>\n{body}\n</svg>\n'
    )


def _room(room: Room) -> Iterator[str]:
    (south_m, west_m), (north_m, east_m) = room.bounds_ned_m[:, :2].tolist()
    walls = 'fill="none" stroke="black" stroke-width="0.04"'
    yield _rectangle(south_m, west_m, north_m, east_m, walls)
    for south_m, west_m, _, north_m, east_m, _ in room.boxes_ned_m.tolist():
        yield _rectangle(south_m, west_m, north_m, east_m, _FURNITURE)
    for north_m, east_m, radius_m, _, _ in room.cylinders_ned_m.tolist():
        yield _circle(north_m, east_m, radius_m, _FURNITURE)


def _track(path: Sequence[MocapPose]) -> Iterator[str]:
    if not path:
        return
    places = [pose.truth_position_ned_m for pose in (*path[::STEP_POSES], path[-1])]
    points = " ".join(f"{east_m:.3f},{-north_m:.3f}" for north_m, east_m, _ in places)
    yield f'<polyline points="{points}" fill="none" stroke="#0072b2" stroke-width="0.03"/>'
    yield _circle(*places[0][:2], 0.08, 'fill="#009e73"')
    yield _circle(
        *places[-1][:2], HULL_RADIUS_M, 'fill="none" stroke="#0072b2" stroke-width="0.03"'
    )
    touched = path[0].truth_collisions
    for pose in path:
        if pose.truth_collisions > touched:
            touched = pose.truth_collisions
            yield _circle(*pose.truth_position_ned_m[:2], 0.08, 'fill="#d55e00"')


def _rectangle(south_m: float, west_m: float, north_m: float, east_m: float, style: str) -> str:
    return (
        f'<rect x="{west_m:g}" y="{-north_m:g}" width="{east_m - west_m:g}" '
        f'height="{north_m - south_m:g}" {style}/>'
    )


def _circle(north_m: float, east_m: float, radius_m: float, style: str) -> str:
    return f'<circle cx="{east_m:.3f}" cy="{-north_m:.3f}" r="{radius_m:g}" {style}/>'
