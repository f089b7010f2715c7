"""The camera on the vehicle: where it looks from, and what its motion does to the picture."""

from pathlib import Path

import numpy as np
import pytest

from companion.kernel.errors import PlanError
from companion.kernel.messages import FlightMode
from sitl.autopilot.interface import OffboardSetpoint
from sitl.build import build

ROOM = Path(__file__).parents[2] / "flightplans" / "rooms" / "room1.toml"
QUIET = {"read_noise_lsb": 0.0, "shot_noise_white_lsb": 0.0}


def hovering(**camera):
    """A simulation whose vehicle has taken off to 1.2 m."""
    simulation = build(ROOM, {"camera": QUIET | camera}, seed=1, camera_rate_hz=10.0)
    world = simulation.world
    world.advance_to(3.0)
    world.autopilot.arm()
    world.autopilot.take_off(1.2)
    world.advance_to(12.0)
    return simulation


def turn(simulation, yaw_rate_rad_s, until_s):
    """Flies on the spot in offboard mode."""
    world = simulation.world
    while world.time_s < until_s:
        world.autopilot.set_offboard_setpoint(
            OffboardSetpoint(velocity_ned_m_s=(0.0, 0.0, 0.0), yaw_rate_rad_s=yaw_rate_rad_s)
        )
        world.autopilot.set_mode(FlightMode.OFFBOARD)
        world.advance_to(world.time_s + 0.1)


def sharpness(image):
    """Mean horizontal gradient: what blur from yaw takes away."""
    return float(np.abs(np.diff(image.astype(float), axis=1)).mean())


def test_frames_come_at_the_cameras_period_with_the_worlds_stamp():
    simulation = build(ROOM, {}, seed=1, camera_rate_hz=30.0)
    stamps = [simulation.next_frame().stamp_ns for _ in range(4)]
    assert stamps == [k * 1_000_000_000 // 30 for k in (1, 2, 3, 4)]


def test_a_rate_that_the_physics_cannot_give_is_refused_with_the_nearest():
    with pytest.raises(PlanError, match="camera rate 7 Hz"):
        build(ROOM, {}, seed=1, camera_rate_hz=7.0)


def test_a_long_exposure_blurs_a_turning_view_and_leaves_a_still_one():
    frozen, blurred = hovering(), hovering(exposure_s=0.03)
    ratios = []
    for yaw_rate_rad_s, until_s in ((0.0, 14.0), (1.5, 15.0)):
        for simulation in (frozen, blurred):
            turn(simulation, yaw_rate_rad_s, until_s)
        ratios.append(sharpness(blurred.next_frame().left) / sharpness(frozen.next_frame().left))
    assert ratios[0] == pytest.approx(1.0, abs=0.05)
    assert ratios[1] < 0.85
