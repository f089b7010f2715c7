"""``companion fly`` as a user starts it: how soon it flies, and how much memory it takes."""

import math
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from companion.kernel.clock import wall_s
from companion.kernel.errors import CompanionError
from tools.bench.harness import PLAN, Row

LIBRARIES = "import cv2, mavsdk, mcap, msgspec, numba, numpy, rich, sklearn, typer, zmq"
SPEED = 10
SETTINGS = ("experiment.initial_s=10", "experiment.learning_s=40", "experiment.test_s=10")
POLL_PERIOD_S = 0.01


class Watched(NamedTuple):
    """A process that ended. Its first frame is what the log grew by after its header."""

    ran_s: float
    first_frame_s: float
    peak_mb: float


def rows() -> Iterator[Row]:
    with tempfile.TemporaryDirectory() as folder:
        overrides = [word for setting in SETTINGS for word in ("--set", setting)]
        fly = ("-m", "companion", "fly", str(PLAN), "--speed", str(SPEED), "--log-dir", folder)
        imported = watch(["-c", LIBRARIES], Path(folder))
        flown = watch([*fly, *overrides], Path(folder))
    beside = "importing the libraries it stands on"
    yield Row.of(
        f"companion fly, speed {SPEED}: start to first frame in flight",
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


def watch(arguments: Sequence[str], logs: Path) -> Watched:
    """Runs this Python with ``arguments`` to its end. Raises CompanionError when it fails."""
    began_s = wall_s()
    first_frame_s, peak_mb, header_bytes = math.nan, 0.0, 0
    with (
        tempfile.TemporaryFile("w+") as errors,
        subprocess.Popen(
            [sys.executable, *arguments], stdout=subprocess.DEVNULL, stderr=errors
        ) as process,
    ):
        while _still_runs(process):
            peak_mb = max(peak_mb, _peak_mb(process.pid))
            log_bytes = sum(path.stat().st_size for path in logs.glob("*/flight.mcap"))
            header_bytes = header_bytes or log_bytes
            if math.isnan(first_frame_s) and log_bytes > header_bytes:
                first_frame_s = wall_s() - began_s
        if process.returncode != 0:
            errors.seek(0)
            lines = errors.read().strip().splitlines() or ["no message"]
            raise CompanionError(f"{' '.join(arguments[:3])}: {lines[-1]}")
    return Watched(wall_s() - began_s, first_frame_s, peak_mb)


def _still_runs(process: subprocess.Popen[bytes]) -> bool:
    """Looks again after POLL_PERIOD_S at the latest."""
    try:
        process.wait(POLL_PERIOD_S)
    except subprocess.TimeoutExpired:
        return True
    return False


def _peak_mb(pid: int) -> float:
    """Most memory that was resident so far; 0 when the process has just ended."""
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0.0
    peaks = [line.split()[1] for line in status.splitlines() if line.startswith("VmHWM")]
    return float(peaks[0]) / 1024.0 if peaks else 0.0
