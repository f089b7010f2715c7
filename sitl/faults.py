"""What can be made to go wrong while the vehicle flies."""

from typing import TYPE_CHECKING, Annotated

from msgspec import Meta

from companion.kernel.frames import Vector3
from companion.kernel.settings import Settings
from sitl.camera_faults import EyeFault, PairFault

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
    left_eye: EyeFault | None = None
    """What becomes of its images; ``"none"`` mends it."""
    right_eye: EyeFault | None = None
    stereo_pair: PairFault | None = None
    """What becomes of both together."""


class TimedFaults(Faults, frozen=True, kw_only=True):
    """Faults that begin by themselves."""

    at_s: Annotated[float, Meta(ge=0.0)]
    """The world's time, which begins before take-off."""


def inject(world: "World", faults: Faults) -> float:
    """Does it between two steps; the world's time at which it was done."""
    if faults.wind_ned_m_s is not None:
        world.set_wind(faults.wind_ned_m_s)
    if faults.charge_norm is not None:
        world.autopilot.set_charge(faults.charge_norm)
    for rotor, efficiency_norm in enumerate(faults.motor_efficiency_norm or ()):
        world.airframe.set_motor_efficiency(rotor, efficiency_norm)
    world.camera_faults.left_eye = faults.left_eye or world.camera_faults.left_eye
    world.camera_faults.right_eye = faults.right_eye or world.camera_faults.right_eye
    world.camera_faults.pair = faults.stereo_pair or world.camera_faults.pair
    return world.time_s
