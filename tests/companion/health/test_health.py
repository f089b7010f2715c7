"""The cameras' health: every fault found in time and by its name, and none where there is none."""

from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from companion.health import CameraHealth, HealthSettings
from companion.kernel.frames import matrix_from_euler
from companion.kernel.messages import CameraFault, FlightMode, Percept
from companion.vision.stereo import StereoMatcher, StereoSettings
from sitl.arena.camera import CameraSettings, StereoCameraModel
from sitl.arena.room import load_room
from sitl.autopilot.interface import OffboardSetpoint
from sitl.build import build
from sitl.camera_faults import CameraFaults, EyeFault, PairFault

ROOMS = Path(__file__).parents[3] / "flightplans" / "rooms"
SOUND_S = 1.0
"""Of a reel, before the fault begins."""
EYE_FAULTS = {
    "no_frames": CameraFault.NO_FRAMES,
    "frozen": CameraFault.FROZEN,
    "black": CameraFault.BLACK,
    "saturated": CameraFault.SATURATED,
    "half": CameraFault.HALF,
    "torn": CameraFault.TORN,
    "defocused": CameraFault.BLURRED,
    "dirty": CameraFault.BLURRED,
}
PAIR_FAULTS = {
    "swapped": CameraFault.SWAPPED,
    "decalibrated": CameraFault.DECALIBRATED,
    "desynchronised": CameraFault.DESYNCHRONISED,
    "late": CameraFault.LATE,
}


def take_reel(room, rate_hz, duration_s=3.0):
    """Frames of a flight ahead and round, and the camera's calibration."""
    simulation = build(ROOMS / f"{room}.toml", {}, seed=1, camera_rate_hz=rate_hz)
    world, autopilot = simulation.world, simulation.world.autopilot
    world.advance_to(3.0)
    autopilot.arm()
    autopilot.take_off(1.2)
    world.advance_to(12.0)
    frames = []
    for number in range(round(duration_s * rate_hz)):
        turning = number % round(rate_hz) > rate_hz / 2
        autopilot.set_offboard_setpoint(
            OffboardSetpoint(
                velocity_ned_m_s=(0.0 if turning else 0.5, 0.0, 0.0), yaw_rate_rad_s=0.8 * turning
            )
        )
        autopilot.set_mode(FlightMode.OFFBOARD)
        frames.append(simulation.next_frame())
    return frames, simulation.camera.calibration


@pytest.fixture(
    scope="module", params=[(room, hz) for room in ("room1", "office") for hz in (10, 30)]
)
def reel(request):
    return take_reel(*request.param)


class Watched:
    """Health, fed as the pipeline feeds it."""

    def __init__(self, calibration, trusted=True):
        self.health = CameraHealth(HealthSettings(), stale_after_s=0.5)
        self.matcher = StereoMatcher(StereoSettings(), calibration)
        self.trusted = trusted
        self.events = []
        self.records = []
        self.signs = 0

    def see(self, frame, arrived_s):
        look, stereo_px = self.health.look(frame, arrived_s), np.nan
        if look.both:
            stereo = self.matcher.match(frame.left, frame.right)
            if self.health.compare(self.matcher.last_matches(), stereo.valid_norm):
                stereo_px = stereo.disparity_px
        self.signs += np.isnan(stereo_px)
        percept = Percept(
            stamp_ns=frame.stamp_ns, stereo_px=stereo_px, stereo_valid_norm=1.0,
            mono_px=2.0, mono_std_px=0.5,
        )  # fmt: skip
        outlook = self.health.conclude(percept, self.trusted)
        self.events += [(arrived_s, event.text) for event in outlook.events]
        if outlook.record is not None:
            self.records.append((arrived_s, outlook.record))
        return outlook.available


def watch(reel, **faults):
    """The reel with faults from SOUND_S on; what was found, and the time from which they acted."""
    frames, calibration = reel
    camera, watched = CameraFaults(np.random.default_rng(3)), Watched(calibration)
    begins_s = frames[0].stamp_ns * 1e-9 + SOUND_S
    for frame in frames:
        now_s = frame.stamp_ns * 1e-9
        if now_s > begins_s:
            for name, fault in faults.items():
                setattr(camera, name, fault)
        delivered = camera.deliver(frame)
        if delivered is not None:
            watched.see(delivered, now_s)
    return watched, begins_s


def first(watched, place):
    """(time, fault) of the first record that says something of this place."""
    return next(
        (time_s, getattr(record, f"{place}_fault"))
        for time_s, record in watched.records
        if getattr(record, f"{place}_fault")
    )


def test_the_simulator_can_do_every_fault_that_is_tested():
    assert set(get_args(EyeFault)) == {"none", *EYE_FAULTS}
    assert set(get_args(PairFault)) == {"none", "no_frames", "frozen", *PAIR_FAULTS}


def test_a_healthy_camera_shows_no_sign_on_any_frame(reel):
    watched, _ = watch(reel)
    assert (watched.signs, watched.events, watched.records) == (0, [], [])


@pytest.mark.parametrize("eyes", [("left",), ("right",), ("left", "right")], ids="-".join)
@pytest.mark.parametrize(("fault", "named"), EYE_FAULTS.items())
def test_an_eyes_fault_is_named_within_half_a_second(reel, eyes, fault, named):
    watched, begins_s = watch(reel, **{f"{eye}_eye": fault for eye in eyes})
    found = {eye: first(watched, eye) for eye in eyes}
    assert {fault for _, fault in found.values()} == {named}
    assert min(found_s for found_s, _ in found.values()) - begins_s < 0.51
    # Of two torn eyes, each tells of the other: which ones they are takes a few frames more.
    assert max(found_s for found_s, _ in found.values()) - begins_s < 1.0
    last = watched.records[-1][1]
    assert (last.stereo, last.left, last.right) == (False, "left" not in eyes, "right" not in eyes)
    assert not last.pair_fault


@pytest.mark.parametrize(("fault", "named"), PAIR_FAULTS.items())
def test_a_pairs_fault_is_named_within_half_a_second(reel, fault, named):
    watched, begins_s = watch(reel, pair=fault)
    place = "timing" if fault in ("late", "desynchronised") else "pair"
    found_s, found = first(watched, place)
    assert found == named
    begins_s += 0.3 * (fault == "late")  # until then none comes at all
    assert found_s - begins_s < 0.51
    last = watched.records[-1][1]
    assert (last.stereo, last.left, last.right) == (fault == "late", True, True)


def test_both_eyes_of_a_driver_that_is_stuck_are_frozen(reel):
    watched, begins_s = watch(reel, pair="frozen")
    for eye in ("left", "right"):
        found_s, found = first(watched, eye)
        assert found == CameraFault.FROZEN
        assert found_s - begins_s < 0.51


def test_a_wall_that_is_nearer_than_stereo_reaches_is_no_fault():
    """The disparity of what is 0.26 m away is 27 px; at 0.16 m the hull touches."""
    model = StereoCameraModel(
        load_room(ROOMS / "room1.toml"), CameraSettings(), np.random.default_rng(0)
    )
    for yaw_rad in np.arange(4) * np.pi / 2:
        ahead = np.array([np.cos(yaw_rad), np.sin(yaw_rad)])
        ned_from_frd, watched = matrix_from_euler(0.0, 0.0, yaw_rad), Watched(model.calibration)
        for _ in range(20):  # the exposure settles
            model.render((*ahead, -1.2), ned_from_frd, 0)
        for number, distance_m in enumerate(np.linspace(1.4, 0.26, 32), start=1):
            place = (*(ahead * (2.5 - 0.1 - distance_m)), -1.2)
            frame = model.render(place, ned_from_frd, number * 10**8)
            watched.see(frame, frame.stamp_ns * 1e-9)
        assert (watched.signs, watched.events) == (0, [])


def test_turning_beside_a_pillar_is_no_fault():
    """Its face is nearer than the search reaches and slanting: no one shift lays the eyes over
    each other, and rows apart fit as well as level ones.
    """
    model = StereoCameraModel(
        load_room(ROOMS / "corridor.toml"), CameraSettings(), np.random.default_rng(0)
    )
    watched = Watched(model.calibration)
    place = (0.832, -0.507, -1.27)
    for _ in range(20):  # the exposure settles
        model.render(place, matrix_from_euler(0.0, 0.0, -2.7), 0)
    for number, yaw_rad in enumerate(np.arange(-2.7, 0.0, 0.08), start=1):
        frame = model.render(place, matrix_from_euler(0.0, 0.0, yaw_rad), number * 10**8)
        watched.see(frame, frame.stamp_ns * 1e-9)
    assert watched.events == []
