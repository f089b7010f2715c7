"""Where something was at a time between two reports of it."""

import bisect
import math
from typing import NamedTuple

from companion.kernel.frames import Quaternion, Vector3

KEPT_NS = 2_000_000_000
"""Reports older than this are nobody's neighbours any more."""
GAP_LIMIT_NS = 250_000_000
"""Between reports further apart nobody knows the way; a pose is never made up."""


class Pose(NamedTuple):
    stamp_ns: int
    position_ned_m: Vector3
    ned_from_frd: Quaternion


class Track:
    """Vectors by stamp, which may come late, twice and in any order."""

    def __init__(self) -> None:
        self._stamps_ns: list[int] = []
        self._values: list[tuple[float, ...]] = []

    @property
    def newest_ns(self) -> int | None:
        return self._stamps_ns[-1] if self._stamps_ns else None

    def add(self, stamp_ns: int, value: tuple[float, ...]) -> None:
        place = bisect.bisect_left(self._stamps_ns, stamp_ns)
        if place < len(self._stamps_ns) and self._stamps_ns[place] == stamp_ns:
            return
        self._stamps_ns.insert(place, stamp_ns)
        self._values.insert(place, value)
        stale = bisect.bisect_left(self._stamps_ns, self._stamps_ns[-1] - KEPT_NS)
        del self._stamps_ns[:stale], self._values[:stale]

    def around(self, stamp_ns: int) -> tuple[tuple[float, ...], tuple[float, ...], float] | None:
        """(before, after, share of the way between them); None where the way is not known."""
        after = bisect.bisect_left(self._stamps_ns, stamp_ns)
        if after == len(self._stamps_ns):
            return None
        if self._stamps_ns[after] == stamp_ns:
            return self._values[after], self._values[after], 0.0
        if after == 0:
            return None
        begin_ns, end_ns = self._stamps_ns[after - 1], self._stamps_ns[after]
        if end_ns - begin_ns > GAP_LIMIT_NS:
            return None
        share = (stamp_ns - begin_ns) / (end_ns - begin_ns)
        return self._values[after - 1], self._values[after], share


class PoseTrack:
    """Positions and attitudes, together or from two streams with stamps of their own."""

    def __init__(self) -> None:
        self._places = Track()
        self._attitudes = Track()

    @property
    def newest_ns(self) -> int | None:
        """Up to here nothing better will come, but for what is late."""
        place_ns, attitude_ns = self._places.newest_ns, self._attitudes.newest_ns
        return None if place_ns is None or attitude_ns is None else min(place_ns, attitude_ns)

    def add(
        self, stamp_ns: int, position_ned_m: Vector3 | None, ned_from_frd: Quaternion | None
    ) -> None:
        if position_ned_m is not None:
            self._places.add(stamp_ns, position_ned_m)
        if ned_from_frd is not None:
            self._attitudes.add(stamp_ns, ned_from_frd)

    def at(self, stamp_ns: int) -> Pose | None:
        """Straight between two positions, evenly between two attitudes."""
        place, attitude = self._places.around(stamp_ns), self._attitudes.around(stamp_ns)
        if place is None or attitude is None:
            return None
        north_m, east_m, down_m = _between(*place)
        return Pose(stamp_ns, (north_m, east_m, down_m), _turned(*attitude))


def _between(
    before: tuple[float, ...], after: tuple[float, ...], share: float
) -> tuple[float, ...]:
    return tuple(a + share * (b - a) for a, b in zip(before, after, strict=True))


def _turned(before: tuple[float, ...], after: tuple[float, ...], share: float) -> Quaternion:
    """Along the chord, which for the small turns between two reports is the arc; w >= 0."""
    if sum(a * b for a, b in zip(before, after, strict=True)) < 0.0:
        after = tuple(-b for b in after)
    w, x, y, z = _between(before, after, share)
    norm = math.copysign(math.sqrt(w * w + x * x + y * y + z * z), w)
    return w / norm, x / norm, y / norm, z / norm
