"""The simulator in real time, alone and as the companion's child process."""

import asyncio
import json
import logging
import os
import signal
import socket
import subprocess
import sys
from collections import deque
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.calibration import Intrinsics, StereoCalibration
from companion.kernel.clock import wall_s
from companion.kernel.errors import LinkError, PlanError, SimulatorError
from companion.kernel.messages import SimulationRequest
from sitl.cli import main
from sitl.mavlink.links import UdpLink
from sitl.pace import Pace
from sitl.parent import Parent
from sitl.process import launch, reserved_mavlink_port
from sitl.server import CameraServer, RealTimeServer

ROOM = str(Path(__file__).parents[2] / "flightplans" / "rooms" / "room1.toml")
ANY_CAMERA = ("--camera", "tcp://127.0.0.1:0")
EYE = Intrinsics(focal_x_px=10.0, focal_y_px=10.0, centre_x_px=3.5, centre_y_px=2.5)
CALIBRATION = StereoCalibration(width_px=8, height_px=6, left=EYE, right=EYE, baseline_m=0.06)
LIMIT_S = 60.0


class Ticking:
    """A world of ticks only; ``cost_s`` of wall time each."""

    crashed = None

    def __init__(self, cost_s=0.0):
        self.time_s = 0.0
        self.mocap = deque()
        self.exposures = 0
        self._cost_s = cost_s

    def step(self):
        end_s = wall_s() + self._cost_s
        self.time_s += 0.004
        while wall_s() < end_s:
            pass

    works = True

    def expose(self):
        self.exposures += 1


class Mute:
    """No links, and frames that go nowhere."""

    def filenos(self):
        return []

    def poll(self):
        pass

    def update(self, time_s):
        pass

    def beat(self):
        pass

    def publish_truth(self, poses):
        pass

    def publish_frame(self, frame):
        pass


def run_for(world, wall_duration_s, speed):
    mute, end_s = Mute(), wall_s() + wall_duration_s
    server = RealTimeServer(world, world, mute, mute, 10.0, Pace(speed))
    server.run(lambda: wall_s() > end_s)


@pytest.mark.parametrize("speed", [0.5, 1.0, 20.0])
def test_the_world_follows_the_clock(speed):
    world = Ticking()
    run_for(world, 0.4, speed)
    assert 0.5 < world.time_s / (0.4 * speed) < 1.1  # a busy host may make it late, never early
    assert world.exposures == pytest.approx(1 + world.time_s * 10.0, abs=1.0)


def test_a_world_that_is_too_slow_flies_slower_and_says_so_once(caplog, monkeypatch):
    monkeypatch.setattr("sitl.pace.CALM_AFTER_S", 0.1)
    world = Ticking(cost_s=0.004)
    with caplog.at_level(logging.WARNING):
        run_for(world, 0.6, speed=10.0)
    assert world.time_s < 0.8
    assert [record.message[:38] for record in caplog.records] == [
        "this machine cannot keep up with speed"
    ]


def test_a_busy_camera_port_is_one_clear_error():
    first = CameraServer("tcp://127.0.0.1:0", CALIBRATION)
    with pytest.raises(SimulatorError, match=r"^tcp://.*: cannot publish frames: Address"):
        CameraServer(first.url, CALIBRATION)
    first.close()
    with pytest.raises(PlanError, match="not an address for frames"):
        CameraServer("nonsense", CALIBRATION)


def one_line_on_stderr(capsys):
    out, error = capsys.readouterr()
    assert out == ""
    assert error.count("\n") == 1
    return error


def test_a_missing_room_is_one_line_and_exit_code_2(capsys):
    assert main(["run", "nowhere.toml", *ANY_CAMERA, "--mavlink", "udpin://127.0.0.1:0"]) == 2
    assert one_line_on_stderr(capsys).startswith("sitl: nowhere.toml: no such file")


def test_a_bad_link_is_one_line_and_exit_code_2(capsys):
    assert main(["run", ROOM, "--mavlink", "tcp://127.0.0.1:1"]) == 2
    assert "use udpout://HOST:PORT" in one_line_on_stderr(capsys)


def test_a_busy_link_is_one_line_and_exit_code_1(capsys):
    taken = UdpLink("udpin://127.0.0.1:0")
    assert main(["run", ROOM, "--mavlink", taken.url]) == 1
    assert "in use" in one_line_on_stderr(capsys)
    taken.close()


def test_a_bad_setting_is_one_line_and_exit_code_2(capsys, tmp_path):
    settings = tmp_path / "sitl.json"
    settings.write_text('{"airfrme": "x"}')
    words = ["--mavlink", "udpin://127.0.0.1:0", "--settings", str(settings)]
    assert main(["run", ROOM, *ANY_CAMERA, *words]) == 2
    assert "airfrme: unknown key; did you mean 'airframe'?" in one_line_on_stderr(capsys)


def test_help_explains_the_options(capsys):
    assert main(["run", "--help"]) == 0
    text = capsys.readouterr().out
    assert all(word in text for word in ("--mavlink", "--camera", "udpin://", "JSON"))


def test_a_signal_ends_it_cleanly(tmp_path):
    words = ["--mavlink", "udpin://127.0.0.1:0", "--log-dir", str(tmp_path), "--speed", "10"]
    process = subprocess.Popen(
        [sys.executable, "-m", "sitl", "run", ROOM, *ANY_CAMERA, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    ready = json.loads(process.stdout.readline())
    assert ready["ready"] is True
    host, port = ready["mavlink"][0].removeprefix("udpin://").split(":")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.settimeout(LIMIT_S)
        heartbeat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, 8, 0, 0, 4, 3)
        client.sendto(heartbeat.pack(mavlink.MAVLink(None, 245, 190)), (host, int(port)))
        assert client.recv(4096)[0] == 0xFD
    process.send_signal(signal.SIGTERM)
    out, error = process.communicate(timeout=LIMIT_S)
    assert (process.returncode, out, error) == (0, b"", b"")
    assert (tmp_path / "flight.tlog").stat().st_size > 0


def test_a_parent_injects_faults_and_closes_stdin_to_end_it(flight, monkeypatch, capsys):
    read, write = os.pipe()
    monkeypatch.setattr(sys, "stdin", os.fdopen(read))
    parent = Parent(flight.world)
    assert not parent.has_gone()
    os.write(write, b'{"charge_norm":0.5}\n{"wind":3}\n{"charge_n')
    assert not parent.has_gone()
    done, refused = map(json.loads, capsys.readouterr().out.splitlines())
    assert done == {"time_s": 0.0}
    assert "unknown field `wind`" in refused["error"]
    assert flight.autopilot.status.battery_norm == 0.5
    os.write(write, b'orm":0.4}\n')
    assert not parent.has_gone()
    assert flight.autopilot.status.battery_norm == 0.4
    os.close(write)
    assert parent.has_gone()
    sys.stdin.close()


def request(tmp_path, **changes):
    fields = {"room": ROOM, "seed": 1, "speed": 5.0, "camera_rate_hz": 10.0}
    return SimulationRequest(**{**fields, "log_dir": str(tmp_path), **changes})


@pytest.fixture
def children(monkeypatch):
    """The processes that are started."""
    started = []
    start = asyncio.create_subprocess_exec

    async def remember(*words, **options):
        started.append(await start(*words, **options))
        return started[-1]

    monkeypatch.setattr(asyncio, "create_subprocess_exec", remember)
    return started


def test_two_flights_get_different_ports():
    with reserved_mavlink_port() as one, reserved_mavlink_port() as other:
        assert one != other
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as companion:
            companion.bind(("127.0.0.1", one))  # the reservation leaves the port itself free


def test_a_wrong_plan_is_said_as_the_child_said_it(tmp_path):
    async def run():
        async with launch(request(tmp_path, room="nowhere.toml")):
            pass

    with pytest.raises(PlanError, match=r"^nowhere.toml: no such file"):
        asyncio.run(run())


def test_a_death_in_flight_ends_the_flight(tmp_path, children):
    async def run():
        async with launch(request(tmp_path)):
            children[-1].kill()
            await asyncio.Event().wait()

    with pytest.raises(SimulatorError, match=r"the simulator died in flight \(exit code -9\)"):
        asyncio.run(run())


def test_a_death_explains_what_came_of_it(tmp_path, children):
    async def run():
        async with launch(request(tmp_path)):
            children[-1].kill()
            try:
                await asyncio.Event().wait()
            finally:
                raise LinkError("gone")

    with pytest.raises(SimulatorError, match=r"the simulator died in flight") as caught:
        asyncio.run(run())
    assert isinstance(caught.value.__cause__, LinkError)


def test_other_errors_pass_and_the_child_ends(tmp_path, children):
    async def run():
        async with launch(request(tmp_path)):
            raise LinkError("mine")

    with pytest.raises(LinkError, match="mine"):
        asyncio.run(run())
    assert children[0].returncode == 0
