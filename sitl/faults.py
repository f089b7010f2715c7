"""What can be made to go wrong while the vehicle flies."""

from collections.abc import Mapping
from typing import Annotated, Final, Literal

from msgspec import Meta, field

from companion.kernel.errors import PlanError
from companion.kernel.frames import Vector3
from companion.kernel.settings import Settings
from sitl.autopilot.parameters import change_parameter, default_parameters, parameter_problem
from sitl.camera_faults import EyeFault, PairFault
from sitl.conditions import Delay, Norm
from sitl.failures import SUPPORTED, Kind, Unit

UnitName = Literal[
    "magnetometer",
    "barometer",
    "gps",
    "optical_flow",
    "vision",
    "range_finder",
    "battery",
    "camera",
    "sticks",
]
KindName = Literal["ok", "off", "stuck", "garbage"]
UNITS: Final[Mapping[str, Unit]] = {unit.name.lower(): unit for unit in SUPPORTED}


class Faults(Settings, frozen=True):
    """Each key that is given acts from now on; the others leave things as they are."""

    wind_ned_m_s: Vector3 | None = None
    """Where the air moves to, steady and everywhere the same."""
    gusts_w20_m_s: Annotated[float, Meta(ge=0.0, le=25.0)] | None = None
    """Turbulence that belongs to this mean wind at 20 ft."""
    ground_effect_norm: Annotated[float, Meta(ge=0.0, le=2.0)] | None = None
    charge_norm: Norm | None = None
    """State of charge that the battery jumps to."""
    motor_efficiency_norm: tuple[Norm, Norm, Norm, Norm] | None = None
    """Thrust that each rotor still makes, over that of a sound one; in PX4's order."""
    estimator_drift_ned_m_s: Vector3 | None = None
    """Velocity is measured wrong by this, and the position walks away with it."""
    failures: dict[UnitName, KindName] = field(default_factory=dict)
    """Units that fail, and how; "ok" mends them."""
    parameters: dict[str, float] = field(default_factory=dict)
    """PX4's, by name."""
    link_loss_norm: Norm | None = None
    """These act on the companion's link, in both directions: see ``LinkSettings``."""
    link_latency_s: Delay | None = None
    link_jitter_s: Delay | None = None
    link_duplicate_norm: Norm | None = None
    left_eye: EyeFault | None = None
    """What becomes of its images; ``"none"`` mends it."""
    right_eye: EyeFault | None = None
    stereo_pair: PairFault | None = None
    """What becomes of both together."""


class Event(Faults, frozen=True, kw_only=True):
    """Faults that begin by themselves."""

    at_s: Annotated[float, Meta(ge=0.0)]
    """The world's time, which begins before take-off."""


def check(faults: Faults, where: str = "") -> None:
    """Raises PlanError for what cannot be; ``where`` is the path of the table, with its dot."""
    check_parameters(faults.parameters, where)
    for unit, kind in faults.failures.items():
        possible = SUPPORTED[UNITS[unit]]
        if Kind[kind.upper()] not in possible:
            names = ", ".join(sorted(kind.name.lower() for kind in possible))
            raise PlanError(f"{where}failures.{unit}: cannot be {kind!r}; allowed: {names}")


def check_parameters(values: Mapping[str, float], where: str = "") -> None:
    """Raises PlanError for the first that is unknown or out of range."""
    scratch = default_parameters()
    for name, value in values.items():
        if not change_parameter(scratch, name, value):
            raise PlanError(f"{where}parameters.{name}: {value:g}: {parameter_problem(name)}")
