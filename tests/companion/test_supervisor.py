"""The service manager's protocol, on a real socket; and the unit file that goes with it."""

import asyncio
import configparser
import socket
from pathlib import Path

import numpy as np
import pytest

from companion.cli import app
from companion.flying.safety import SafetySettings
from companion.kernel.clock import SimClock
from companion.kernel.errors import PlanError
from companion.loops import Heartbeat, pulse
from companion.supervisor import Supervisor

UNIT = Path(__file__).parents[2] / "deploy" / "companion.service"


class Manager:
    """systemd's end of the socket."""

    def __init__(self, address):
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(address)
        self._socket.setblocking(False)

    def told(self):
        """Since the last call."""
        lines = []
        while True:
            try:
                lines += self._socket.recv(4096).decode().split("\n")
            except BlockingIOError:
                return lines

    def close(self):
        self._socket.close()


@pytest.fixture(params=["path", "abstract"])
def manager(request, tmp_path):
    """(its end, the environment that it starts services in)."""
    name = str(tmp_path / "notify") if request.param == "path" else f"@{tmp_path}"
    end = Manager(name.replace("@", "\0", 1))
    yield end, {"NOTIFY_SOCKET": name, "WATCHDOG_USEC": "1500000"}
    end.close()


def test_it_tells_how_the_flight_goes(manager):
    end, environment = manager
    supervisor = Supervisor.from_environment(environment)
    supervisor.ready()
    supervisor.status("test,\n 12 s flown")
    supervisor.stopping()
    assert end.told() == ["READY=1", "WATCHDOG=1", "STATUS=test, 12 s flown", "STOPPING=1"]


def test_it_answers_the_watchdog_as_often_as_needed_and_no_more(manager, monkeypatch):
    end, environment = manager
    clock = SimClock()
    monkeypatch.setattr("companion.supervisor.wall_s", clock.now_s)
    supervisor = Supervisor.from_environment(environment)
    told_s = []
    for tenth in range(200):
        clock.time_s = tenth / 10
        supervisor.alive()
        told_s += [clock.time_s] * len(end.told())
    gaps_s = np.diff(told_s)
    assert told_s[0] == 0.0
    assert (gaps_s.min(), gaps_s.max()) == (pytest.approx(0.4), pytest.approx(0.4))


@pytest.mark.parametrize("environment", [{}, {"NOTIFY_SOCKET": "/nowhere/at/all"}])
def test_without_a_manager_nothing_happens(environment):
    supervisor = Supervisor.from_environment(environment)
    assert supervisor.listens == bool(environment)
    supervisor.ready()
    supervisor.alive()
    supervisor.status("flying")
    supervisor.stopping()


def test_a_manager_that_does_not_read_keeps_nobody_waiting(manager):
    supervisor = Supervisor.from_environment(manager[1])
    for _ in range(2000):
        supervisor.stopping()


def test_a_watchdog_that_makes_no_sense_is_refused():
    with pytest.raises(PlanError, match="WATCHDOG_USEC=soon: must be a number of microseconds"):
        Supervisor.from_environment({"WATCHDOG_USEC": "soon"})


class Counter:
    """A supervisor that only counts."""

    def __init__(self):
        self.count = 0

    def alive(self):
        self.count += 1


@pytest.mark.parametrize(
    ("flying", "age_s", "alive"),
    [(True, 0.0, True), (True, 4.9, True), (True, 5.1, False), (False, 60.0, True)],
)
def test_the_watchdog_is_answered_while_percepts_come_or_none_are_due(flying, age_s, alive):
    clock, counter = SimClock(), Counter()
    heartbeat = Heartbeat(now_s=100.0)
    heartbeat.flying = flying
    clock.time_s = 100.0 + age_s

    async def run():
        beating = asyncio.create_task(pulse(clock, lambda: heartbeat, SafetySettings(), counter))
        for _ in range(10):
            await clock.sleep(0.0)
        beating.cancel()
        await asyncio.wait({beating})

    asyncio.run(run())
    assert bool(counter.count) == alive


def test_the_unit_file_starts_what_there_is_and_lands_before_it_kills():
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str
    unit.read(UNIT)
    service = unit["Service"]
    assert (service["Type"], service["Restart"]) == ("notify", "on-abnormal")
    assert service["WatchdogSec"] == "1500ms"
    assert float(service["TimeoutStopSec"]) > 90.0  # companion.app.LAND_LIMIT_S
    words = service["ExecStart"].split()
    assert words[0].endswith("companion")
    options = {word for word in words if word.startswith("--")}
    import typer.main

    known = typer.main.get_command(app).commands["fly"].params
    assert options <= {name for parameter in known for name in parameter.opts}
