"""A short flight on simulated time, and a browser to look at its report with."""

import asyncio
import fcntl
import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from companion.flight import FlightOrder, fly_plan
from companion.flightlog import FlightLog, FlightLogWriter, Topic
from companion.kernel.messages import Decision, Percept, Setpoint, Telemetry
from companion.plan import load_plan

PLAN = Path(__file__).parents[3] / "flightplans" / "room1.toml"
SHORT = ("experiment.initial_s=8", "experiment.learning_s=12", "experiment.test_s=12")
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FREE_FD = 10


@pytest.fixture(scope="session")
def flown_dir(tmp_path_factory):
    """Its log folder; copy it before changing anything."""
    folder = tmp_path_factory.mktemp("flown") / "room1-flight"
    folder.mkdir()
    plan = load_plan(PLAN, SHORT)
    order = FlightOrder(plan=plan, plan_path=PLAN, vehicle="lockstep", log_dir=folder)
    asyncio.run(fly_plan(order, lambda step, pipeline: None))
    return folder


class Browser:
    """Headless Chromium, spoken to through its debugging pipe."""

    def __init__(self, program, profile):
        to_read, self._to = os.pipe()
        self._from, to_write = os.pipe()
        ends = [fcntl.fcntl(fd, fcntl.F_DUPFD, FREE_FD) for fd in (to_read, to_write)]
        self._process = subprocess.Popen(
            [program, "--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-pipe",
             "--window-size=1200,900", f"--user-data-dir={profile}"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=(3, 4),
            preexec_fn=lambda: (os.dup2(ends[0], 3), os.dup2(ends[1], 4)),
        )  # fmt: skip
        for fd in (to_read, to_write, *ends):
            os.close(fd)
        self._number = 0
        self._received = b""
        self.events = []

    def call(self, method, session=None, **parameters):
        self._number += 1
        order = {"id": self._number, "method": method, "params": parameters}
        order |= {"sessionId": session} if session else {}
        os.write(self._to, json.dumps(order).encode() + b"\0")
        while (message := self._next()).get("id") != self._number:
            self.events.append(message)
        assert "error" not in message, message
        return message["result"]

    def wait_for(self, method):
        while not any(event.get("method") == method for event in self.events):
            self.events.append(self._next())

    def _next(self):
        while b"\0" not in self._received:
            data = os.read(self._from, 1 << 20)
            assert data, "the browser is gone"
            self._received += data
        message, _, self._received = self._received.partition(b"\0")
        return json.loads(message)

    def close(self):
        for fd in (self._to, self._from):
            os.close(fd)  # it ends with its pipe
        self._process.wait()

    def open(self, path):
        """The page's session; ``events`` holds all that happened while it loaded."""
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable", session)
        self.events.clear()
        self.call("Page.navigate", session, url=path.resolve().as_uri())
        self.wait_for("Page.loadEventFired")
        return session

    def evaluate(self, session, expression):
        result = self.call("Runtime.evaluate", session, expression=expression, returnByValue=True)
        return result["result"]["value"]


@pytest.fixture(scope="session")
def browser(tmp_path_factory):
    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    if program is None:
        pytest.skip("no Chromium to look at the page with; on Debian: apt-get install chromium")
    browser = Browser(program, tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()


@pytest.fixture
def without_truth():
    """``without_truth(log, copy)``: the copy holds no motion capture, as on a real vehicle.

    More events can be given.
    """

    def copy(source, target, *events):
        log = FlightLog(source)
        with FlightLogWriter(target, log.metadata) as writer:
            kinds = {
                Topic.PERCEPT: Percept,
                Topic.DECISION: Decision,
                Topic.TELEMETRY: Telemetry,
                Topic.SETPOINT: Setpoint,
            }
            records = [
                (int(time_ns), topic, record)
                for topic, kind in kinds.items()
                for time_ns, record in zip(
                    log.log_times_ns(topic), log.read(topic, kind), strict=True
                )
            ]
            for time_ns, topic, record in sorted(records, key=lambda item: item[0]):
                writer.write(topic, record, log_time_ns=time_ns)
            for event in events:
                writer.write(Topic.EVENT, event)
        return target

    return copy
