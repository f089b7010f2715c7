"""A port on which a running simulator is told to pause, to step, to go on; lines in, JSON out."""

import socket
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Final
from urllib.parse import urlsplit

import msgspec

from companion.kernel.errors import PlanError, SimulatorError
from sitl.mavlink.tcp_link import TcpClient, TcpLink
from sitl.pace import FASTEST, SLOWEST, Pace
from sitl.parent import InjectedLine, RefusedLine, injected

if TYPE_CHECKING:  # whoever talks to a console needs no flight dynamics
    from sitl.simulator import World

VERBS: Final = "pause, resume, step [COUNT], run SECONDS, speed FACTOR, state, or faults as JSON"
MOST_STEPS: Final = 100_000_000
"""Of one line: days of flight."""
LONGEST_LINE: Final = 4096
MOST_UNREAD_BYTES: Final = 65536
"""Of one client, who is hung up on beyond that."""


class StateLine(msgspec.Struct, frozen=True):
    """Answers every line that is obeyed; of ``step`` and ``run`` when the steps are taken."""

    time_s: float
    paused: bool
    speed: float


class Console:
    """Any number of clients; each is answered line by line, in order."""

    def __init__(self, url: str, world: "World", pace: Pace) -> None:
        """``url``: tcp://HOST:PORT, port 0 for any."""
        host, port = _address(url)
        self._link = TcpLink(f"tcpin://{host}:{port}")
        self.url = self._link.url.replace("tcpin", "tcp")
        self._world = world
        self._pace = pace
        self._unread: dict[TcpClient, bytes] = {}
        self._stepping: set[TcpClient] = set()

    def filenos(self) -> list[int]:
        return self._link.filenos()

    def poll(self) -> None:
        """Obeys what has come; never blocks."""
        while (arrived := self._link.receive()) is not None:
            client, data = arrived
            self._unread[client] = self._unread.get(client, b"") + data
        if self._stepping and self._pace.idle:
            for client in self._stepping:
                _send(client, self._state())
            self._stepping.clear()
        present = set(self._link.clients)
        self._unread = {client: rest for client, rest in self._unread.items() if client in present}
        for client in self._unread:
            self._read(client)

    def close(self) -> None:
        self._link.close()

    def _read(self, client: TcpClient) -> None:
        """Whole lines, up to one that takes its time."""
        while client not in self._stepping and b"\n" in self._unread[client]:
            line, _, self._unread[client] = self._unread[client].partition(b"\n")
            answer = self._obey(line.strip())
            if answer is None:
                self._stepping.add(client)
            else:
                _send(client, answer)
        if len(self._unread[client]) > MOST_UNREAD_BYTES:
            client.close()

    def _obey(self, line: bytes) -> StateLine | InjectedLine | RefusedLine | None:
        """None for steps, which are answered once they are taken."""
        if len(line) > LONGEST_LINE:
            return RefusedLine(f"a line has at most {LONGEST_LINE} bytes")
        if line.startswith(b"{"):
            return injected(self._world, line)
        verb, *numbers = line.decode("ascii", "replace").split() or [""]
        try:
            return self._do(verb, [float(number) for number in numbers])
        except ValueError:
            return RefusedLine(f"{line.decode('ascii', 'replace')[:40]!r}: use {VERBS}")

    def _do(self, verb: str, numbers: Sequence[float]) -> StateLine | None:
        """Raises ValueError for what is no command."""
        world, pace, steps = self._world, self._pace, 0.0
        match verb, numbers:
            case "state", []:
                pass
            case "pause", []:
                pace.pause()
            case "resume", []:
                pace.resume(world.time_s)
            case "speed", [factor] if SLOWEST <= factor <= FASTEST:
                pace.set_speed(factor, world.time_s)
            case "step", []:
                steps = 1.0
            case "step", [count] if count.is_integer() and count >= 1.0:
                steps = count
            case "run", [duration_s] if duration_s * world.physics_hz >= 0.5:
                steps = duration_s * world.physics_hz
            case _:
                raise ValueError
        if steps == 0.0:
            return self._state()
        pace.step(round(min(steps, MOST_STEPS)))
        return None

    def _state(self) -> StateLine:
        return StateLine(self._world.time_s, self._pace.paused, self._pace.speed)


def ask(url: str, lines: Sequence[str]) -> Iterator[str]:
    """The answer to each line, as it comes. Raises SimulatorError when nobody answers."""
    try:
        with (
            socket.create_connection(_address(url)) as connection,
            connection.makefile("rw", encoding="ascii") as stream,
        ):
            for line in lines:
                stream.write(f"{line}\n")
                stream.flush()
                if not (answer := stream.readline()):
                    raise SimulatorError(f"{url}: the simulator has ended")
                yield answer.rstrip()
    except OSError as error:
        raise SimulatorError(f"{url}: {error.strerror or error}") from error


def refused(answer: str) -> bool:
    return "error" in msgspec.json.decode(answer)


def _send(client: TcpClient, answer: msgspec.Struct) -> None:
    client.send(msgspec.json.encode(answer) + b"\n")


def _address(url: str) -> tuple[str, int]:
    parts = urlsplit(url)
    try:
        if parts.scheme == "tcp" and parts.hostname and parts.port is not None:
            return parts.hostname, parts.port
    except ValueError:  # a port that is none
        pass
    raise PlanError(f"{url}: not an address for control; use tcp://HOST:PORT, port 0 for any")
