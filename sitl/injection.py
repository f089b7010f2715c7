"""Makes things go wrong in a world, between two of its steps."""

from typing import Protocol

import msgspec

from sitl.autopilot.autopilot import Autopilot
from sitl.camera_faults import CameraFaults
from sitl.conditions import LinkConditions
from sitl.environment.surroundings import Surroundings
from sitl.failures import Kind
from sitl.faults import UNITS, Faults, check

LINK_PREFIX = "link_"
"""Of the keys that concern the companion's link."""


class Breakable(Protocol):
    """What of a world may go wrong."""

    autopilot: Autopilot
    surroundings: Surroundings
    camera_faults: CameraFaults
    link: LinkConditions

    @property
    def time_s(self) -> float: ...


def inject(world: Breakable, faults: Faults) -> float:
    """Does it between two steps; the world's time at which it was done.

    Raises PlanError, with nothing done, for what cannot be: which key, and what is allowed.
    """
    check(faults)
    autopilot, surroundings = world.autopilot, world.surroundings
    for name, value in faults.parameters.items():
        autopilot.set_parameter(name, value)
    if faults.wind_ned_m_s is not None:
        surroundings.wind_ned_m_s = faults.wind_ned_m_s
    if faults.gusts_w20_m_s is not None:
        surroundings.gusts_w20_m_s = faults.gusts_w20_m_s
    if faults.ground_effect_norm is not None:
        surroundings.ground_effect_norm = faults.ground_effect_norm
    if faults.charge_norm is not None:
        autopilot.set_charge(faults.charge_norm)
    if faults.motor_efficiency_norm is not None:
        autopilot.failures.motor_efficiency_norm = faults.motor_efficiency_norm
    if faults.estimator_drift_ned_m_s is not None:
        autopilot.set_drift(faults.estimator_drift_ned_m_s)
    for unit, kind in faults.failures.items():
        autopilot.failures.inject(UNITS[unit], Kind[kind.upper()])
    eyes = world.camera_faults
    eyes.left_eye = faults.left_eye or eyes.left_eye
    eyes.right_eye = faults.right_eye or eyes.right_eye
    eyes.pair = faults.stereo_pair or eyes.pair
    _impair(world.link, faults)
    return world.time_s


def _impair(link: LinkConditions, faults: Faults) -> None:
    given = msgspec.structs.asdict(faults)
    changes = {
        key.removeprefix(LINK_PREFIX): value
        for key, value in given.items()
        if key.startswith(LINK_PREFIX) and value is not None
    }
    link.settings = msgspec.structs.replace(link.settings, **changes)
