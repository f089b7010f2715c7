"""One flight of the matrix as a user flies it: companion and vehicle in processes of their own."""

import asyncio
import math
import resource
import signal
import sys
import tempfile
from asyncio.subprocess import PIPE, Process
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import msgspec

from companion.camera.remote import RemoteCamera
from companion.flightlog import FlightLog, Topic
from companion.kernel.clock import WallClock
from companion.kernel.errors import EXIT_FLOWN, EXIT_USAGE, CompanionError, RecordingError
from companion.kernel.messages import MocapPose, SimulationRequest
from companion.logfolder import LOG_NAME
from companion.plan import room_path
from sitl.process import SitlProcess, open_sitl
from tools.faults.cases import PLAN_WORDS, Outcome
from tools.faults.lockstep import DISK_BYTES, STILL_M_S, Task, model_for, plan_of
from tools.faults.results import Flown

SPEED = 10.0
FLIGHT_LIMIT_S = 200.0
"""Wall time."""
ALONE_S = 30.0
JUDGED_S = 2.0
GROUND_M = 0.3
KILL_MARK = "   30 s  "
"""How the companion's progress begins when the test phase does."""


class _Watched:
    """The vehicle as motion capture sees it, whatever becomes of its companion."""

    def __init__(self, camera: RemoteCamera) -> None:
        self._camera = camera
        self._poses: list[MocapPose] = []

    @property
    def poses(self) -> list[MocapPose]:
        self._poses += self._camera.drain()
        return self._poses

    def comes_to(self) -> Outcome:
        """On the ground, at rest or neither, in the last seconds."""
        last = self.poses[-1]
        earlier = next(p for p in self.poses if p.stamp_ns >= last.stamp_ns - JUDGED_S * 1e9)
        if -last.truth_position_ned_m[2] < GROUND_M:
            return Outcome.LANDS
        moved_m = math.dist(last.truth_position_ned_m, earlier.truth_position_ned_m)
        return Outcome.HOLDS if moved_m < STILL_M_S * JUDGED_S else Outcome.FLIES_AWAY


def fly(task: Task) -> Flown:
    """Flies it beside this process."""
    with tempfile.TemporaryDirectory() as folder:
        return asyncio.run(_fly(task, Path(folder))).without_folder(folder)


async def _fly(task: Task, folder: Path) -> Flown:
    plan, plan_path = plan_of(task)
    model = await asyncio.to_thread(model_for, task, folder)
    (folder / "sitl").mkdir()
    request = SimulationRequest(
        room=str(room_path(plan, plan_path)),
        seed=plan.seed,
        speed=SPEED,
        camera_rate_hz=plan.camera.rate_hz,
        log_dir=str(folder / "sitl"),
        settings=msgspec.to_builtins(plan.sitl),
    )
    async with open_sitl(request) as child, RemoteCamera(child.endpoints.camera_url) as camera:
        watched = _Watched(camera)
        words = _words(task, plan_path, folder, child, model)
        start = partial(_start, words, DISK_BYTES if task.case.deed == "full disk" else None)
        process = await start()
        lost_s = 0.0
        if task.case.deed == "kill and restart":
            await _kill_at_the_mark(process)
            killed_ns = watched.poses[-1].stamp_ns
            process = await start()
        code, reason = await _ended(process)
        await WallClock(SPEED).sleep(ALONE_S)
        if task.case.deed == "kill and restart":
            lost_s = (killed_ns - _logged_ns(min((folder / "logs").iterdir()))) * 1e-9
        return _flown(task, _outcome(watched, code), reason, watched.poses, lost_s)


def _words(
    task: Task, plan_path: Path, folder: Path, child: SitlProcess, model: Path | None
) -> list[str]:
    settings = [word for text in (*PLAN_WORDS, *task.case.words) for word in ("--set", text)]
    return [
        *("fly", str(plan_path), *settings, "--seed", str(task.seed), "--speed", str(SPEED)),
        *("--vehicle", child.endpoints.mavlink_url, "--camera", child.endpoints.camera_url),
        *("--log-dir", str(folder / "logs"), "--resume"),
        *(() if model is None else ("--model", str(model))),
    ]


async def _start(words: Sequence[str], file_limit_bytes: int | None) -> Process:
    def limit_files() -> None:
        if file_limit_bytes is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (file_limit_bytes, file_limit_bytes))

    return await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "companion", *words),
        stdout=PIPE,
        stderr=PIPE,
        preexec_fn=limit_files,
    )


async def _kill_at_the_mark(process: Process) -> None:
    assert process.stderr is not None
    async with asyncio.timeout(FLIGHT_LIMIT_S):
        async for line in process.stderr:
            if line.decode(errors="replace").startswith(KILL_MARK):
                process.send_signal(signal.SIGKILL)
    await process.wait()


async def _ended(process: Process) -> tuple[int, str]:
    """(exit code, last line on stderr). Raises CompanionError when it does not end."""
    try:
        async with asyncio.timeout(FLIGHT_LIMIT_S):
            _, said = await process.communicate()
    except TimeoutError:
        process.kill()
        raise CompanionError(f"a companion did not end within {FLIGHT_LIMIT_S:.0f} s") from None
    lines = said.decode(errors="replace").splitlines()
    code = process.returncode
    assert code is not None
    return code, "" if code == EXIT_FLOWN else lines[-1]


def _outcome(watched: _Watched, code: int) -> Outcome:
    if code == EXIT_USAGE:
        return Outcome.REFUSES
    came_to = watched.comes_to()
    return Outcome.FLIES if came_to is Outcome.LANDS and code == EXIT_FLOWN else came_to


def _logged_ns(folder: Path) -> int:
    """The newest frame in a flight's log; 0 for none."""
    try:
        return int(FlightLog(folder / LOG_NAME).columns(Topic.PERCEPT)["stamp_ns"][-1])
    except RecordingError:
        return 0


def _flown(
    task: Task, observed: Outcome, reason: str, poses: Sequence[MocapPose], lost_s: float
) -> Flown:
    return Flown(
        way="mavlink",
        case=task.case.name,
        moment=task.moment,
        room=task.room,
        seed=task.seed,
        expected=task.case.expected,
        observed=observed,
        collisions=poses[-1].truth_collisions,
        lost_s=max(0.0, lost_s),
        reason=reason,
    )
