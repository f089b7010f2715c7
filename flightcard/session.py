"""The vehicles of one test: how they are opened, and that they are closed."""

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import AbstractAsyncContextManager, ExitStack, asynccontextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self, TypeVar

from companion.camera.remote import RemoteCamera
from companion.kernel.messages import MocapPose, StereoFrame
from flightcard.card import FlightCard
from flightcard.evidence import Evidence
from flightcard.flown import CompanionProcess, Flown, fly_in_lockstep
from flightcard.machines import Machine, open_lockstep, open_sitl_process
from flightcard.order import Folders, Order, find, order_from
from sitl.process import open_arena

T = TypeVar("T")
OpenMachine = Callable[[Order], AbstractAsyncContextManager[Machine]]


class Session:
    """One event loop for all of a test's vehicles, so that one flies while another is waited for;
    ``wishes`` are the keywords of the test's markers.
    """

    def __init__(self, folders: Folders, log_dir: Path, wishes: Mapping[str, Any]) -> None:
        self.companion = Companion(self)
        self.folders = folders
        self._log_dir = log_dir
        self._wishes = wishes
        self._open = ExitStack()
        self._evidence: list[Evidence] = []
        self._folders_made = 0

    def __enter__(self) -> Self:
        self._runner = self._open.enter_context(asyncio.Runner())
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._open.close()

    def open_lockstep(self, **wishes: object) -> FlightCard:
        return self._open_card("lockstep", open_lockstep, wishes)

    def open_sitl(self, **wishes: object) -> FlightCard:
        return self._open_card("sitl", open_sitl_process, wishes)

    def open_arena(self, *, pose: str, **wishes: object) -> "Arena":
        order = self._order(wishes, self.new_folder("arena"))
        camera = self._enter(_arena_camera(order, pose))
        return Arena(camera, self._runner)

    def new_folder(self, name: str) -> Path:
        """``name-1`` and so on, for one vehicle's logs."""
        self._folders_made += 1
        folder = self._log_dir / f"{name}-{self._folders_made}"
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def call_at_the_end(self, close: Callable[[], None]) -> None:
        self._open.callback(close)

    def sections(self) -> list[tuple[str, str]]:
        """(title, text) for the report of a failed test; whole logs are left when it is closed."""
        return [(f"flight of {evidence.name}", evidence.report()) for evidence in self._evidence]

    def _open_card(self, name: str, machine: OpenMachine, wishes: dict[str, Any]) -> FlightCard:
        folder = self.new_folder(name)
        order = self._order(wishes, folder)
        opened = self._enter(machine(order))
        assert opened.rig.mocap is not None
        evidence = Evidence(folder.name, order, opened.rig.mocap, folder)
        self._open.callback(evidence.leave)
        self._evidence.append(evidence)
        card = FlightCard(opened, order, evidence, self._runner)
        self._open.callback(card.close)
        return card

    def _order(self, wishes: dict[str, Any], folder: Path) -> Order:
        return order_from({**self._wishes, **wishes}, self.folders, folder)

    def _enter(self, context: AbstractAsyncContextManager[T]) -> T:
        """Opens it on the loop now, and closes it there when the test is over."""

        async def leave() -> None:
            await context.__aexit__(None, None, None)

        async def enter() -> T:
            return await context.__aenter__()

        opened = self._runner.run(enter())
        self._open.callback(lambda: self._runner.run(leave()))
        return opened


class Companion:
    """Flights of the companion as a user starts them."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def fly(self, plan: str, *overrides: str) -> Flown:
        """In lockstep, in this process; raises nothing when the flight fails: see the summary."""
        folders = self._session.folders
        path = find(plan, folders, folders.plans)
        return fly_in_lockstep(path, overrides, self._session.new_folder("companion"))

    def start(
        self,
        plan: str,
        vehicle: str,
        *words: str,
        preexec: Callable[[], None] | None = None,
    ) -> CompanionProcess:
        """``companion fly PLAN --vehicle VEHICLE``, killed at the end of the test."""
        folders = self._session.folders
        path = find(plan, folders, folders.plans)
        log_dir = self._session.new_folder("companion")
        process = CompanionProcess(path, log_dir, vehicle, words, preexec)
        self._session.call_at_the_end(process.end)
        return process


class Arena(NamedTuple):
    """``sitl arena`` at work; frames and truth as the companion gets them."""

    camera: RemoteCamera
    runner: asyncio.Runner

    def next_frame(self) -> StereoFrame:
        return self.runner.run(_first(self.camera))

    def poses(self) -> list[MocapPose]:
        """Where it took the vehicle to be, since the last call."""
        return self.camera.drain()


@asynccontextmanager
async def _arena_camera(order: Order, pose_url: str) -> AsyncIterator[RemoteCamera]:
    async with (
        open_arena(order.request, pose_url) as camera_url,
        RemoteCamera(camera_url) as camera,
    ):
        yield camera


async def _first(camera: RemoteCamera) -> StereoFrame:
    return await anext(camera.frames())
