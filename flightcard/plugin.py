"""pytest's side: options, the marker, fixtures, and what is kept of a failed flight.

pytest imports this module in every run, so all else is imported by the fixtures that need it.
"""

import re
import shutil
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from flightcard.card import FlightCard
    from flightcard.session import Arena, Companion, Session

MARKER = (
    "flight(room, plan, overrides, seed, speed, camera_rate_hz, sitl, faults): what the test's "
    "vehicles fly in and with; the marker nearest to the test wins, key by key."
)
SESSION = pytest.StashKey["Session"]()
FAILED = pytest.StashKey[bool]()

MakeCard = Callable[..., "FlightCard"]


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addini(
        "flightplans", "Folder of plans, with rooms/ in it, that tests name.", default="flightplans"
    )
    parser.addini(
        "flight_logs", "Folder that keeps the logs of failed flights.", default="flight-logs"
    )


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", MARKER)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item,
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    session = item.stash.get(SESSION, None)
    if session is not None and report.failed:
        item.stash[FAILED] = True
        report.sections += session.sections()
    return report


@pytest.fixture
def flights(request: pytest.FixtureRequest) -> "Iterator[Session]":
    """All vehicles of this test: opened by the other fixtures, closed here whatever happens."""
    from flightcard.order import Folders
    from flightcard.session import Session

    config, item = request.config, request.node
    folders = Folders(
        test=item.path.parent,
        project=config.rootpath,
        plans=config.rootpath / config.getini("flightplans"),
    )
    log_dir = config.rootpath / config.getini("flight_logs") / _folder_name(item)
    _remove(log_dir)  # what an earlier failure left
    session = Session(folders, log_dir, _wishes(item))
    item.stash[SESSION] = session
    try:
        with session:
            yield session
    finally:
        if not item.stash.get(FAILED, False):
            _remove(log_dir)


@pytest.fixture
def make_lockstep(flights: "Session") -> MakeCard:
    """``make_lockstep(seed=2, ...)``: one more vehicle; keywords as of the marker."""
    return flights.open_lockstep


@pytest.fixture
def make_sitl(flights: "Session") -> MakeCard:
    """``make_sitl(seed=2, ...)``: one more vehicle; keywords as of the marker."""
    return flights.open_sitl


@pytest.fixture
def lockstep(make_lockstep: MakeCard) -> "FlightCard":
    """A vehicle in this process, on simulated time: repeatable to the byte."""
    return make_lockstep()


@pytest.fixture
def sitl(make_sitl: MakeCard) -> "FlightCard":
    """A vehicle in a process of its own, through MAVSDK on free ports."""
    return make_sitl()


@pytest.fixture
def arena(flights: "Session") -> "Callable[..., Arena]":
    """``arena(pose=URL)``: the marker's room around another autopilot."""
    return flights.open_arena


@pytest.fixture
def companion(flights: "Session") -> "Companion":
    """``companion.fly(plan, ...)`` in lockstep, ``companion.start(plan, ...)`` as a process."""
    return flights.companion


def _wishes(item: pytest.Item) -> dict[str, Any]:
    """The keywords of all its ``flight`` markers, nearer ones over those of class and module."""
    wishes: dict[str, Any] = {}
    for marker in reversed(list(item.iter_markers("flight"))):
        wishes |= marker.kwargs
    return wishes


def _folder_name(item: pytest.Item) -> Path:
    """One folder per test; of a name that any file system takes."""
    return Path(re.sub(r"[^\w.-]+", "-", item.nodeid).strip("-"))


def _remove(log_dir: Path) -> None:
    shutil.rmtree(log_dir, ignore_errors=True)
    if log_dir.parent.is_dir() and not any(log_dir.parent.iterdir()):
        log_dir.parent.rmdir()
