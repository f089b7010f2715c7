"""Puts the simulation together: a room, the world in it, the camera on the vehicle."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.kernel.calibration import StereoCalibration
from companion.kernel.frames import Vector3, matrix_from_euler
from companion.kernel.messages import StereoFrame
from companion.kernel.settings import convert_settings
from sitl.airframe import AirframeState
from sitl.arena.camera import StereoCameraModel
from sitl.arena.contact import RoomContact
from sitl.arena.room import load_room
from sitl.failures import Kind, Unit
from sitl.follower import Follower
from sitl.mavlink.places import Origin
from sitl.settings import SitlSettings
from sitl.simulator import World

BLUR_POSES = 5
"""Views averaged for motion blur: at this resolution more look the same."""

CAMERA_STREAM, BROKEN_CAMERA_STREAM = 1, 3
"""Keys of random numbers among those spawned from the seed; the world's are 0 and 4, the
links' 2."""


class MountedCamera:
    """The stereo camera on the vehicle: shows what is there, unless it fails."""

    def __init__(self, world: World, model: StereoCameraModel, rng: np.random.Generator) -> None:
        """``rng`` makes up what a broken camera shows."""
        self._world = world
        self._model = model
        self._rng = rng
        self._last: StereoFrame | None = None

    @property
    def calibration(self) -> StereoCalibration:
        return self._model.calibration

    def expose(self) -> StereoFrame | None:
        """The pair as of now, the middle of the exposure; what failures and faults leave of it."""
        kind, stamp_ns = self._world.autopilot.failures.of(Unit.CAMERA), self._world.stamp_ns
        if kind is Kind.OFF:
            return None
        if kind is Kind.STUCK and self._last is not None:
            return StereoFrame(stamp_ns, self._last.left, self._last.right)
        if kind is Kind.GARBAGE:
            shape = self.calibration.height_px, self.calibration.width_px
            left, right = self._rng.integers(0, 256, (2, *shape), np.uint8)
            return StereoFrame(stamp_ns, left, right)
        self._last = frame = self._world.camera_faults.deliver(self._seen())
        return frame

    def _seen(self) -> StereoFrame:
        truth, exposure_s = self._world.truth, self._model.settings.exposure_s
        offsets_s = np.linspace(-0.5, 0.5, BLUR_POSES) * exposure_s if exposure_s > 0.0 else (0.0,)
        poses = [_pose_at(truth, float(offset_s)) for offset_s in offsets_s]
        return self._model.render_exposure(poses, self._world.stamp_ns)


def _pose_at(truth: AirframeState, offset_s: float) -> tuple[Vector3, NDArray[np.float64]]:
    """Position and ``ned_from_frd`` this much later, motion going on as it is."""
    north_m, east_m, down_m = (
        place_m + speed_m_s * offset_s
        for place_m, speed_m_s in zip(truth.position_ned_m, truth.velocity_ned_m_s, strict=True)
    )
    # The angles turned in half an exposure are small, so that their order does not matter.
    turned = matrix_from_euler(*(rate * offset_s for rate in truth.rates_frd_rad_s))
    return (north_m, east_m, down_m), matrix_from_euler(*truth.euler_rad) @ turned


class Simulation:
    """A world and its camera; ``next_frame`` moves time to the next exposure."""

    def __init__(
        self, world: World, camera: MountedCamera, camera_rate_hz: float, home: Origin
    ) -> None:
        self.world = world
        self.camera = camera
        self.home = home
        self._steps = world.whole_steps(camera_rate_hz, "camera rate")

    def next_frame(self) -> StereoFrame | None:
        """Steps the world to the next multiple of the camera's period, and exposes there.

        None where faults leave nothing of the frame.
        """
        self.world.advance_to(self.next_exposure_s)
        return self.camera.expose()

    @property
    def next_exposure_s(self) -> float:
        done = round(self.world.time_s * self.world.physics_hz)
        return (done + self._steps - done % self._steps) / self.world.physics_hz


def build(
    room_path: Path, settings: Mapping[str, Any], seed: int, camera_rate_hz: float
) -> Simulation:
    """Everything from its files. Raises PlanError: file or key, and what is allowed."""
    chosen = convert_settings(dict(settings), SitlSettings, "sitl")
    room = load_room(room_path)
    world = World(room, chosen, seed, RoomContact(room))
    model = StereoCameraModel(room, chosen.camera, _rng(seed, CAMERA_STREAM))
    camera = MountedCamera(world, model, _rng(seed, BROKEN_CAMERA_STREAM))
    return Simulation(world, camera, camera_rate_hz, chosen.home)


def build_follower(
    room_path: Path,
    settings: Mapping[str, Any],
    seed: int,
    camera_rate_hz: float,
    rest_height_m: float,
) -> Follower:
    """The room and the camera of ``build``, for a vehicle that flies elsewhere."""
    chosen = convert_settings(dict(settings), SitlSettings, "sitl")
    room = load_room(room_path)
    camera = StereoCameraModel(room, chosen.camera, _rng(seed, CAMERA_STREAM))
    return Follower(room, camera, RoomContact(room), camera_rate_hz, rest_height_m)


def _rng(seed: int, stream: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(stream,)))
