"""``companion fly`` as a user starts it: until the first frame, from camera to setpoint, memory.

The latency is read from the logs of a flight at speed 1: from the exposure's stamp in flight.mcap
to the arrival of that frame's setpoint in the simulator's tlog, both on the vehicle's clock, whose
resolution is one physics step. It holds rendering, both sockets, perception and MAVSDK.
"""

import asyncio
import sys
import tempfile
from asyncio.subprocess import DEVNULL, PIPE, Process
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pymavlink import mavutil

from companion.flightlog import FlightLog, Topic
from companion.kernel.clock import WallClock, wall_s
from companion.kernel.errors import CompanionError
from companion.kernel.messages import Setpoint
from tools.bench.harness import PLAN, Row, race_s
from tools.bench.perception import Parts

PERCENTILE = 99.0
PHYSICS_HZ = 900
LIBRARIES = "import cv2, mavsdk, mcap, msgspec, numba, numpy, rich, sklearn, typer, zmq"
POLL_PERIOD_S = 0.01
QUICK = ("experiment.initial_s=5", "experiment.learning_s=15", "experiment.test_s=10")
FINE = (*QUICK, "camera.rate_hz=30", f"sitl.physics_hz={PHYSICS_HZ}")


class Watched(NamedTuple):
    """A process that ended. The first frame is in the log's first flush after its header."""

    ran_s: float
    first_frame_s: float
    peak_mb: float


def rows() -> Iterator[Row]:
    with tempfile.TemporaryDirectory() as folder:
        quick, fine = Path(folder) / "quick", Path(folder) / "fine"
        imported = asyncio.run(_watch(("-c", LIBRARIES), quick))
        flown = asyncio.run(_watch(_fly_arguments(quick, 10.0, QUICK), quick))
        asyncio.run(_watch(_fly_arguments(fine, 1.0, FINE), fine))
        latency_ms = latencies_s(fine) * 1e3
    beside = "importing the libraries it stands on"
    parts = Parts()
    (perceive_s,) = race_s([parts.perceive], rounds=300)
    yield Row.of(
        "camera to setpoint through MAVSDK, 30 Hz, 99 %",
        float(np.percentile(latency_ms, PERCENTILE)),
        "ms",
        ("perception alone, median", perceive_s * 1e3),
        goal=10.0,
    )
    yield Row.of(
        "companion fly, speed 10, to the first frame in flight",
        flown.first_frame_s,
        "s",
        (beside, imported.ran_s),
        goal=5.0,
    )
    yield Row.of(
        "companion's resident memory, at most",
        flown.peak_mb,
        "MB",
        (beside, imported.peak_mb),
        goal=300.0,
    )


def latencies_s(logs: Path) -> NDArray[np.float64]:
    """From each frame's exposure to the first arrival of its setpoint, of shape (n,).

    Setpoints equal to the one before cannot be told from MAVSDK's repetitions and do not count.
    """
    (flight,) = logs.glob("**/*.mcap")
    (link,) = logs.glob("**/*.tlog")
    arrivals = _arrivals(link)
    found: list[float] = []
    last = b""
    for setpoint in FlightLog(flight).read(Topic.SETPOINT, Setpoint):
        key = _key(*setpoint.velocity_hfrd_m_s)
        if key != last:
            sent_s = setpoint.stamp_ns * 1e-9
            found += [t - sent_s for t in arrivals.get(key, ()) if t >= sent_s][:1]
        last = key
    if not found:
        raise CompanionError(f"{link}: holds none of the setpoints in {flight}")
    return np.array(found)


def _arrivals(link: Path) -> dict[bytes, list[float]]:
    """Times on the vehicle's clock by setpoint, oldest first."""
    arrivals: dict[bytes, list[float]] = {}
    log = mavutil.mavlink_connection(str(link))
    while (message := log.recv_match(type="SET_POSITION_TARGET_LOCAL_NED")) is not None:
        key = _key(message.vx, message.vy, message.vz)
        arrivals.setdefault(key, []).append(message._timestamp)
    log.close()
    return arrivals


def _key(*velocity_m_s: float) -> bytes:
    """Equal for equal setpoints, as single precision carries them."""
    return np.array(velocity_m_s, np.float32).tobytes()


def _fly_arguments(logs: Path, speed: float, options: Sequence[str]) -> tuple[str, ...]:
    overrides = (word for option in options for word in ("--set", option))
    return (
        *("-m", "companion", "fly", str(PLAN), "--vehicle", "sitl", "--camera", "sitl"),
        *("--speed", f"{speed:g}", "--log-dir", str(logs), *overrides),
    )


async def _watch(arguments: tuple[str, ...], logs: Path) -> Watched:
    """Runs this Python with ``arguments`` to its end. Raises CompanionError when that is bad."""
    began_s = wall_s()
    process = await asyncio.create_subprocess_exec(
        sys.executable, *arguments, stdout=DEVNULL, stderr=PIPE
    )
    output = asyncio.create_task(process.communicate())
    first_frame_s, peak_mb, header_bytes = float("nan"), 0.0, 0
    while not output.done():
        peak_mb = max(peak_mb, _peak_mb(process))
        log_bytes = _log_bytes(logs)
        header_bytes = header_bytes or log_bytes
        if np.isnan(first_frame_s) and log_bytes > header_bytes:
            first_frame_s = wall_s() - began_s
        await WallClock().sleep(POLL_PERIOD_S)
    _, errors = await output
    if process.returncode != 0:
        lines = errors.decode().strip().splitlines() or ["no message"]
        raise CompanionError(f"{' '.join(arguments[:3])}: {lines[-1]}")
    return Watched(wall_s() - began_s, first_frame_s, peak_mb)


def _peak_mb(process: Process) -> float:
    """0 when it has just ended."""
    try:
        status = Path(f"/proc/{process.pid}/status").read_text()
    except OSError:
        return 0.0
    peaks = [line.split()[1] for line in status.splitlines() if line.startswith("VmHWM")]
    return float(peaks[0]) / 1024.0 if peaks else 0.0


def _log_bytes(logs: Path) -> int:
    return sum(path.stat().st_size for path in logs.glob("**/*.mcap"))
