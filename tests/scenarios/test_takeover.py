"""A companion that is killed in flight: the next one takes over and brings the vehicle home."""

import asyncio
import os
import signal
import socket
import sys
from asyncio.subprocess import PIPE
from pathlib import Path

import msgspec
import numpy as np
import pytest

from companion.flightlog import FlightLog
from companion.kernel.messages import Event, SimulationRequest
from companion.memory import MODEL_NAME
from sitl.process import open_sitl
from tools.logs.tlog import TelemetryReader

PLANS = Path(__file__).parents[2] / "flightplans"
SPEED = 10.0
PHASES = ("initial_s=8", "learning_s=12", "test_s=15", "scheme=training_wheels")
WORDS = [word for text in PHASES for word in ("--set", f"experiment.{text}")]
HOLD_WITHOUT_SETPOINTS = {"COM_OBL_RC_ACT": 5}
LAND, TAKE_OFF = 21, 22
"""MAV_CMD_NAV_..."""
ON_GROUND = 1
"""MAV_LANDED_STATE"""
LIMIT_S = 100.0


@pytest.fixture
def request_of(tmp_path):
    (tmp_path / "sitl").mkdir()
    return SimulationRequest(
        room=str(PLANS / "rooms" / "room1.toml"),
        seed=1,
        speed=SPEED,
        camera_rate_hz=10.0,
        log_dir=str(tmp_path / "sitl"),
        settings={"parameters": HOLD_WITHOUT_SETPOINTS},
    )


class Companions:
    """``companion fly --resume`` beside a vehicle that outlives it."""

    def __init__(self, endpoints, log_dir):
        self.log_dir = log_dir
        self._words = [
            *("fly", str(PLANS / "room1.toml"), "--speed", str(SPEED), "--resume", *WORDS),
            *("--vehicle", endpoints.mavlink_url, "--camera", endpoints.camera_url),
            *("--log-dir", str(log_dir), "--set", "log.model_period_s=5"),
        ]

    async def start(self, **environment):
        return await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "companion", *self._words),
            stdout=PIPE,
            stderr=PIPE,
            env=os.environ | environment,
        )

    def folders(self):
        return sorted(self.log_dir.iterdir())


async def ended(process):
    async with asyncio.timeout(LIMIT_S):
        _, error = await process.communicate()
    return process.returncode, error.decode().splitlines()


async def heard_before_it_ends(hearing, process):
    """Fails with the companion's own words when it ends first."""
    heard, over = asyncio.ensure_future(hearing), asyncio.ensure_future(process.wait())
    await asyncio.wait({heard, over}, return_when=asyncio.FIRST_COMPLETED)
    over.cancel()
    if not heard.done():
        heard.cancel()
        pytest.fail((await process.stderr.read()).decode())
    heard.result()


class Manager:
    """systemd's end of the socket: what it was told, as it comes."""

    def __init__(self, path):
        self.address = str(path)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(self.address)
        self._socket.setblocking(False)
        self.told = []

    async def hears(self, word):
        """Until a line begins with ``word``."""
        loop = asyncio.get_running_loop()
        async with asyncio.timeout(LIMIT_S):
            while not any(line.startswith(word) for line in self.told):
                self.told += (await loop.sock_recv(self._socket, 4096)).decode().split("\n")

    def close(self):
        self._socket.close()


@pytest.fixture
def manager(tmp_path):
    end = Manager(tmp_path / "notify")
    yield end
    end.close()


def seen(tlog, message, field):
    """By the vehicle, in order."""
    return list(TelemetryReader(tlog).table(message).columns[field])


def test_the_next_companion_takes_over_where_the_last_was_killed(request_of, manager, tmp_path):
    environment = {"NOTIFY_SOCKET": manager.address, "WATCHDOG_USEC": "1500000"}

    async def run():
        async with open_sitl(request_of) as child:
            companions = Companions(child.endpoints, tmp_path / "logs")
            first = await companions.start(**environment)
            await heard_before_it_ends(manager.hears("STATUS=test"), first)
            first.send_signal(signal.SIGKILL)
            await first.wait()
            manager.told.clear()
            second = await companions.start(**environment)
            (code, lines), _ = await asyncio.gather(ended(second), manager.hears("STOPPING=1"))
            return companions.folders(), code, lines

    (killed, resumed), code, lines = asyncio.run(run())
    assert code == 0, lines
    assert manager.told[:2] == ["READY=1", "WATCHDOG=1"]
    assert manager.told.count("WATCHDOG=1") > 3
    before, after = (
        msgspec.json.decode((folder / "summary.json").read_bytes()) for folder in (killed, resumed)
    )
    assert before["reason"] == "the companion was killed in flight"
    assert (after["outcome"], after["collisions"]) == ("flown", 0)

    log = FlightLog(resumed / "flight.mcap")
    first_event = next(log.read("/event", Event))
    assert first_event.text in {f"took over in flight, from {m} mode" for m in ("hold", "offboard")}
    phases = list(dict.fromkeys(log.columns("/decision")["phase"]))
    assert phases in (["learning", "test"], ["test"])  # as of the last checkpoint
    assert np.isfinite(log.columns("/percept")["mono_px"][0])  # nothing was forgotten
    assert (killed / MODEL_NAME).exists()
    tlog = tmp_path / "sitl" / "flight.tlog"
    asked = seen(tlog, "COMMAND_LONG@1.195", "command")
    assert asked.count(TAKE_OFF) == 1
    assert asked.index(LAND) > asked.index(TAKE_OFF)
    assert seen(tlog, "EXTENDED_SYS_STATE", "landed_state")[-1] == ON_GROUND
