"""What can be made to go wrong while the vehicle flies."""

from typing import TYPE_CHECKING

import msgspec

from companion.kernel.frames import Vector3
from companion.kernel.settings import Settings
from sitl.conditions import Delay, LinkConditions, Norm

if TYPE_CHECKING:  # whoever asks another process for faults needs no flight dynamics
    from sitl.simulator import World

_LINK = "link_"


class Faults(Settings, frozen=True):
    """Each key that is given acts from now on; the others leave things as they are."""

    wind_ned_m_s: Vector3 | None = None
    """Where the air moves to, steady and everywhere the same."""
    charge_norm: Norm | None = None
    """State of charge that the battery jumps to."""
    motor_efficiency_norm: tuple[Norm, Norm, Norm, Norm] | None = None
    """Thrust that each rotor still makes, over that of a sound one; in PX4's order."""
    link_loss_norm: Norm | None = None
    """These act on the companion's link, in both directions: see ``LinkSettings``."""
    link_latency_s: Delay | None = None
    link_jitter_s: Delay | None = None
    link_duplicate_norm: Norm | None = None


def inject(world: "World", faults: Faults) -> float:
    """Does it between two steps; the world's time at which it was done."""
    if faults.wind_ned_m_s is not None:
        world.set_wind(faults.wind_ned_m_s)
    if faults.charge_norm is not None:
        world.autopilot.set_charge(faults.charge_norm)
    for rotor, efficiency_norm in enumerate(faults.motor_efficiency_norm or ()):
        world.airframe.set_motor_efficiency(rotor, efficiency_norm)
    _impair(world.link, faults)
    return world.time_s


def _impair(link: LinkConditions, faults: Faults) -> None:
    given = msgspec.structs.asdict(faults)
    changes = {
        key.removeprefix(_LINK): value
        for key, value in given.items()
        if key.startswith(_LINK) and value is not None
    }
    link.settings = msgspec.structs.replace(link.settings, **changes)
