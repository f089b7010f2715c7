"""From camera to setpoint: a real ``companion fly`` around a simulator in this process.

The clock starts when the exposure begins and stops when the simulator has that frame's setpoint,
so it holds rendering, both sockets, perception, the decision and MAVSDK.
"""

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion.flightlog import FlightLog, Topic
from companion.kernel.calibration import StereoCalibration
from companion.kernel.clock import wall_s
from companion.kernel.errors import CompanionError
from companion.kernel.messages import Setpoint, StereoFrame
from companion.plan import load_plan, room_path
from sitl.build import MountedCamera, build
from sitl.mavlink import framing
from sitl.mavlink.links import UdpLink
from sitl.mavlink.server import MavlinkServer
from sitl.mavlink.tlog import TelemetryLog
from sitl.pace import Pace
from sitl.server import CameraServer, RealTimeServer
from tools.bench.harness import PLAN, Row, race_s
from tools.bench.perception import Parts

PERCENTILE = 99.0
SETTINGS = (
    "experiment.initial_s=5",
    "experiment.learning_s=15",
    "experiment.test_s=10",
    "camera.rate_hz=30",
)


def rows() -> Iterator[Row]:
    with tempfile.TemporaryDirectory() as folder:
        exposures, arrivals = fly(Path(folder))
        (path,) = Path(folder).glob("*/flight.mcap")
        setpoints = FlightLog(path).read(Topic.SETPOINT, Setpoint)
        latency_ms = latencies_s(setpoints, exposures, arrivals) * 1e3
    parts = Parts()
    (perceive_s,) = race_s([parts.perceive], rounds=300)
    beside = ("perception alone, median", perceive_s * 1e3)
    yield Row.of("camera to setpoint at 30 Hz, median", float(np.median(latency_ms)), "ms", beside)
    yield Row.of(
        f"camera to setpoint at 30 Hz, {PERCENTILE:g} %",
        float(np.percentile(latency_ms, PERCENTILE)),
        "ms",
        beside,
        goal=10.0,
    )


Exposures = dict[int, float]
"""Wall time at which each frame's exposure began, by stamp [ns]."""
Arrivals = dict[bytes, list[float]]
"""Wall times at which a setpoint arrived, oldest first, by its velocity."""


class TimedCamera:
    """The simulator's camera; remembers when it was asked."""

    def __init__(self, camera: MountedCamera) -> None:
        self._camera = camera
        self.exposures: Exposures = {}

    @property
    def calibration(self) -> StereoCalibration:
        return self._camera.calibration

    def expose(self) -> StereoFrame | None:
        began_s = wall_s()
        frame = self._camera.expose()
        if frame is not None:
            self.exposures[frame.stamp_ns] = began_s
        return frame


class TimedLog(TelemetryLog):
    """The simulator's log of its link; remembers when setpoints came."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.arrivals: Arrivals = {}

    def write(self, time_s: float, frame: bytes) -> None:
        message = framing.decode(frame)
        if message is not None and message.get_type() == "SET_POSITION_TARGET_LOCAL_NED":
            key = velocity_key(message.vx, message.vy, message.vz)
            self.arrivals.setdefault(key, []).append(wall_s())
        super().write(time_s, frame)


def velocity_key(*velocity_hfrd_m_s: float) -> bytes:
    """Equal for equal setpoints, as single precision carries them."""
    return np.array(velocity_hfrd_m_s, np.float32).tobytes()


def latencies_s(
    setpoints: Iterator[Setpoint], exposures: Exposures, arrivals: Arrivals
) -> NDArray[np.float64]:
    """From each frame's exposure to the first arrival of its setpoint, of shape (n,).

    A setpoint equal to the one before cannot be told from MAVSDK's repetitions of that one, and
    does not count.
    """
    found: list[float] = []
    last = b""
    for setpoint in setpoints:
        key = velocity_key(*setpoint.velocity_hfrd_m_s)
        if key != last:
            began_s = exposures[setpoint.stamp_ns]
            found += [t_s - began_s for t_s in arrivals.get(key, ()) if t_s > began_s][:1]
        last = key
    if not found:
        raise CompanionError("none of the flight's setpoints arrived")
    return np.array(found)


def fly(folder: Path) -> tuple[Exposures, Arrivals]:
    """One flight at speed 1, its log below ``folder``. Raises CompanionError when it fails."""
    plan = load_plan(PLAN, SETTINGS)
    simulation = build(room_path(plan, PLAN), plan.sitl, plan.seed, plan.camera.rate_hz)
    camera, log = TimedCamera(simulation.camera), TimedLog(folder / "flight.tlog")
    link = UdpLink("udpin://127.0.0.1:0")
    with (
        closing(MavlinkServer(simulation.world.autopilot, [link], log)) as vehicle,
        closing(CameraServer("tcp://127.0.0.1:0", camera.calibration)) as frames,
        (folder / "errors.txt").open("wb") as errors,
    ):
        server = RealTimeServer(
            simulation.world, camera, vehicle, frames, plan.camera.rate_hz, Pace()
        )
        arguments = _arguments(link.url.replace("udpin", "udpout"), frames.url, folder)
        with subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=errors) as companion:
            server.run(lambda: companion.poll() is not None)
    if companion.returncode != 0:
        lines = (folder / "errors.txt").read_text().strip().splitlines() or ["no message"]
        raise CompanionError(f"companion fly: {lines[-1]}")
    return camera.exposures, log.arrivals


def _arguments(mavlink_url: str, camera_url: str, folder: Path) -> list[str]:
    overrides = [word for setting in SETTINGS for word in ("--set", setting)]
    return [
        *(sys.executable, "-m", "companion", "fly", str(PLAN)),
        *("--vehicle", mavlink_url, "--camera", camera_url, "--log-dir", str(folder)),
        *overrides,
    ]
