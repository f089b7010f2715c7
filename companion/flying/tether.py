"""Where to explore, and when: zones of the ground plan, and the way back into them."""

import math
from collections.abc import Sequence
from typing import Annotated

from msgspec import Meta

from companion.kernel.settings import Settings


class ZoneSettings(Settings, frozen=True):
    """A disc of the ground plan to explore from a time on, until the next zone's time."""

    from_s: Annotated[float, Meta(ge=0, le=86_400)] = 0.0
    """Since the experiment began."""
    centre_m: tuple[float, float] = (0.0, 0.0)
    """North and east of where it took off."""
    radius_m: Annotated[float, Meta(gt=0)] = 2.0


def way_back_rad(
    zones: Sequence[ZoneSettings], elapsed_s: float, north_m: float, east_m: float
) -> float | None:
    """Bearing of the centre of the zone that holds now; None inside it, or where none holds.

    An unknown place is nowhere outside: there is no way back from it.
    """
    begun = [zone for zone in zones if zone.from_s <= elapsed_s]
    if not begun:
        return None
    zone = max(begun, key=lambda zone: zone.from_s)
    to_north_m, to_east_m = zone.centre_m[0] - north_m, zone.centre_m[1] - east_m
    if not math.hypot(to_north_m, to_east_m) > zone.radius_m:
        return None
    return math.atan2(to_east_m, to_north_m)
