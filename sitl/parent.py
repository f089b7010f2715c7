"""Lines of JSON between a simulator and the process that started it, over stdin and stdout."""

import os
import select
import sys
from typing import TYPE_CHECKING

import msgspec
import typer

from companion.kernel.errors import PlanError
from sitl.faults import Faults
from sitl.injection import inject

if TYPE_CHECKING:  # the parent's side needs no flight dynamics
    from sitl.simulator import World

READ_BYTES = 4096


class ReadyLine(msgspec.Struct, frozen=True, kw_only=True):
    """The child's first line."""

    ready: bool = True
    mavlink: list[str]
    camera: str
    control: str | msgspec.UnsetType = msgspec.UNSET


class InjectedLine(msgspec.Struct, frozen=True):
    """Answers each line of faults: the world's time when they began to act."""

    time_s: float


class RefusedLine(msgspec.Struct, frozen=True):
    """Answers a line that is not one of faults."""

    error: str


class Parent:
    """Takes ``Faults`` from stdin; whoever closes it wants the child to end."""

    def __init__(self, world: "World | None" = None) -> None:
        """Without a world there is nothing that could go wrong, and lines are skipped."""
        self._world = world
        self._rest = b""

    def has_gone(self) -> bool:
        """Never blocks; does first what has been asked for."""
        readable, _, _ = select.select([sys.stdin], [], [], 0.0)
        if not readable:
            return False
        read = os.read(sys.stdin.fileno(), READ_BYTES)
        *lines, self._rest = (self._rest + read).split(b"\n")
        if self._world is not None:
            for line in lines:
                typer.echo(msgspec.json.encode(injected(self._world, line)))
        return not read


def injected(world: "World", line: bytes) -> InjectedLine | RefusedLine:
    """Does what one line of faults asks for."""
    try:
        return InjectedLine(inject(world, msgspec.json.decode(line, type=Faults)))
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError, PlanError) as error:
        return RefusedLine(str(error))
