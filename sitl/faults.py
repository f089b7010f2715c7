"""What can be made to go wrong while the vehicle flies."""

from typing import TYPE_CHECKING, Annotated

from msgspec import Meta

from companion.kernel.frames import Vector3
from companion.kernel.settings import Settings

if TYPE_CHECKING:  # whoever asks another process for faults needs no flight dynamics
    from sitl.simulator import World

Norm = Annotated[float, Meta(ge=0.0, le=1.0)]


class Faults(Settings, frozen=True):
    """Each key that is given acts from now on; the others leave things as they are."""

    wind_ned_m_s: Vector3 | None = None
    """Where the air moves to, steady and everywhere the same."""
    charge_norm: Norm | None = None
    """State of charge that the battery jumps to."""
    motor_efficiency_norm: tuple[Norm, Norm, Norm, Norm] | None = None
    """Thrust that each rotor still makes, over that of a sound one; in PX4's order."""


def inject(world: "World", faults: Faults) -> float:
    """Does it between two steps; the world's time at which it was done."""
    if faults.wind_ned_m_s is not None:
        world.set_wind(faults.wind_ned_m_s)
    if faults.charge_norm is not None:
        world.autopilot.set_charge(faults.charge_norm)
    for rotor, efficiency_norm in enumerate(faults.motor_efficiency_norm or ()):
        world.airframe.set_motor_efficiency(rotor, efficiency_norm)
    return world.time_s
