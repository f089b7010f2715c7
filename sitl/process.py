"""The simulator as a process of its own: started, watched and ended by the companion."""

import asyncio
import json
import logging
import socket
import sys
from asyncio.subprocess import PIPE, Process
from collections import deque
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager, suppress
from pathlib import Path
from typing import NamedTuple, NoReturn

import msgspec

from companion.kernel.errors import CompanionError, PlanError, SimulatorError
from companion.kernel.messages import SimulationRequest
from companion.kernel.protocols import Endpoints
from sitl.faults import Faults
from sitl.parent import InjectedLine, ReadyLine

logger = logging.getLogger(__name__)

HOST = "127.0.0.1"
MAVLINK_PORTS = range(14600, 15000)
"""Below the ports that systems hand out on their own, so that nobody gets one by chance."""
READY_LIMIT_S = 120.0
"""Wall time until the child says that it is ready; compiling for a cold cache takes most of it."""
END_LIMIT_S = 5.0
KEPT_ERROR_LINES = 5
LAST_WORD = "sitl: "
"""How the child's last line begins when it ends in an error: the text of ours, so not logged."""


class _Child(NamedTuple):
    process: Process
    ready: ReadyLine
    errors: deque[str]
    """The last lines on its stderr."""


class SitlProcess:
    """A running child: where it can be reached, and a way to make things go wrong in it."""

    def __init__(self, child: _Child, endpoints: Endpoints) -> None:
        self.endpoints = endpoints
        self.links = child.ready.mavlink
        """All MAVLink URLs as the child has them, the companion's first."""
        self._child = child
        self._process = child.process

    @property
    def pid(self) -> int:
        return self._process.pid

    async def watch(self) -> NoReturn:
        """Waits for the child's death, and raises what it died of."""
        await self._process.wait()
        raise _death(self._process, self._child.errors, "died in flight")

    async def inject(self, faults: Faults) -> float:
        """The world's time at which the child did it. Raises SimulatorError when it is gone."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with suppress(ConnectionError):
            self._process.stdin.write(msgspec.json.encode(faults) + b"\n")
            await self._process.stdin.drain()
        line = await self._process.stdout.readline()
        if not line:
            raise SimulatorError("the simulator died before a fault could be injected")
        try:
            return msgspec.json.decode(line, type=InjectedLine).time_s
        except msgspec.MsgspecError as error:
            raise SimulatorError(f"the simulator refused a fault: {line.decode()}") from error


@asynccontextmanager
async def launch(request: SimulationRequest) -> AsyncIterator[Endpoints]:
    """The entry point ``sitl`` of the companion's simulators.

    Raises SimulatorError when the process does not come up, or dies while it is needed.
    """
    async with open_sitl(request) as child:
        yield child.endpoints


@asynccontextmanager
async def open_sitl(
    request: SimulationRequest, more_links: Sequence[str] = ()
) -> AsyncIterator[SitlProcess]:
    """``launch`` for those who want more of the child than a flight does."""
    with reserved_mavlink_port() as port:
        words = _run_words(request, [f"udpout://{HOST}:{port}", *more_links])
        async with _open(words) as child:
            yield SitlProcess(child, Endpoints(f"udpin://{HOST}:{port}", child.ready.camera))


@asynccontextmanager
async def open_arena(request: SimulationRequest, pose_url: str) -> AsyncIterator[str]:
    """``sitl arena`` as a child, around the autopilot at ``pose_url``; the URL of its frames."""
    words = ["arena", request.room, "--pose", pose_url, *_camera_words(request)]
    async with _open(words) as child:
        yield child.ready.camera


@asynccontextmanager
async def _open(words: Sequence[str]) -> AsyncIterator[_Child]:
    process = await _start(words)
    errors: deque[str] = deque(maxlen=KEPT_ERROR_LINES)
    relay = asyncio.create_task(_relay_errors(process, errors), name="sitl's stderr")
    try:
        ready = await _await_ready(process, relay, errors)
        async with _watched(process, relay, errors):
            yield _Child(process, ready, errors)
    finally:
        await _end(process)
        await relay


@contextmanager
def reserved_mavlink_port() -> Iterator[int]:
    """A UDP port that no other flight takes: the TCP port of the same number is the lock."""
    for port in MAVLINK_PORTS:
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as lock:
            if _can_bind(lock, port):
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                    free = _can_bind(probe, port)
                if free:
                    yield port
                    return
    first, last = MAVLINK_PORTS[0], MAVLINK_PORTS[-1]
    raise SimulatorError(f"no free UDP port for MAVLink among {first} to {last}")


def _can_bind(opened: socket.socket, port: int) -> bool:
    try:
        opened.bind((HOST, port))
    except OSError:
        return False
    return True


def _run_words(request: SimulationRequest, links: Sequence[str]) -> list[str]:
    link_words = (word for link in links for word in ("--mavlink", link))
    speed_words = ("--speed", str(request.speed), "--log-dir", request.log_dir)
    return ["run", request.room, *link_words, *speed_words, *_camera_words(request)]


def _camera_words(request: SimulationRequest) -> list[str]:
    """What every child is told. Raises SimulatorError when the settings cannot be left for it."""
    settings = Path(request.log_dir) / "sitl.json"
    try:
        settings.write_text(json.dumps(request.settings, indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        raise SimulatorError(f"{settings}: cannot be written: {error.strerror}") from error
    options = {
        "--camera": f"tcp://{HOST}:0",
        "--camera-rate": str(request.camera_rate_hz),
        "--seed": str(request.seed),
        "--settings": str(settings),
    }
    return [word for option in options.items() for word in option]


async def _start(words: Sequence[str]) -> Process:
    # A session of its own: an interrupt from the terminal is the companion's, which first lands.
    return await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "sitl", *words, "--until-stdin-closes"),
        stdin=PIPE,
        stdout=PIPE,
        stderr=PIPE,
        start_new_session=True,
    )


async def _relay_errors(process: Process, errors: deque[str]) -> None:
    assert process.stderr is not None
    async for line in process.stderr:
        errors.append(line.decode(errors="replace").rstrip())
        if not errors[-1].startswith(LAST_WORD):
            logger.warning("%s", errors[-1])


async def _await_ready(
    process: Process, relay: asyncio.Task[None], errors: deque[str]
) -> ReadyLine:
    assert process.stdout is not None
    try:
        async with asyncio.timeout(READY_LIMIT_S):
            line = await process.stdout.readline()
            if not line:
                await process.wait()
                await relay
    except TimeoutError:
        raise SimulatorError(f"the simulator was not ready within {READY_LIMIT_S:g} s") from None
    if not line:
        raise _death(process, errors, "did not start")
    try:
        return msgspec.json.decode(line, type=ReadyLine)
    except msgspec.MsgspecError as error:
        raise SimulatorError(f"the simulator said {line[:80]!r} instead of being ready") from error


def _death(process: Process, errors: deque[str], what: str) -> CompanionError:
    """The child's last words; a mistake in the plan stays one."""
    code = process.returncode
    said = errors[-1].removeprefix(LAST_WORD) if errors else "it said nothing"
    if code == PlanError.exit_code:
        return PlanError(said)
    return SimulatorError(f"the simulator {what} (exit code {code}): {said}")


@asynccontextmanager
async def _watched(
    process: Process, relay: asyncio.Task[None], errors: deque[str]
) -> AsyncIterator[None]:
    """Cancels the body when the process dies, and turns what comes of it into SimulatorError."""
    body = asyncio.current_task()
    assert body is not None

    async def watch() -> None:
        await process.wait()
        await relay
        body.cancel()

    watcher = asyncio.create_task(watch(), name="sitl watch")
    try:
        yield
    except asyncio.CancelledError:
        if not watcher.done() or body.uncancel() > 0:  # somebody else's wish, perhaps as well
            raise
        raise _death(process, errors, "died in flight") from None
    except CompanionError as error:
        if process.returncode is None:
            raise
        if watcher.done():
            body.uncancel()
        raise _death(process, errors, "died in flight") from error
    finally:
        watcher.cancel()
        await asyncio.wait({watcher})


async def _end(process: Process) -> None:
    """Asks by closing its input, then by signals; returns when it is gone."""
    assert process.stdin is not None
    process.stdin.close()
    for ask in (process.terminate, process.kill):
        if process.returncode is None:
            try:
                async with asyncio.timeout(END_LIMIT_S):
                    await process.wait()
            except TimeoutError:
                ask()
    await process.wait()
