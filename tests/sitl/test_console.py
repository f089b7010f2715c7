"""Pausing, stepping and hurrying a running simulator."""

import json
import logging
import socket
import threading
from contextlib import closing

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.clock import wall_s
from companion.kernel.errors import PlanError, SimulatorError
from sitl.cli import main
from sitl.console import Console, ask
from sitl.pace import Pace
from sitl.server import RealTimeServer

LIMIT_S = 30.0


class NoCamera:
    works = True

    def expose(self):
        pass

    def publish_truth(self, poses):
        poses.clear()

    def publish_frame(self, frame):
        pass


class Running:
    """A vehicle in real time on a thread, with its console; the client is used from the test."""

    def __init__(self, flight, speed=1.0, paused=False):
        self.flight = flight
        pace = Pace(speed, paused=paused)
        self.console = Console("tcp://127.0.0.1:0", flight.world, pace)
        nothing = NoCamera()
        server = RealTimeServer(
            flight.world, nothing, flight.server, nothing, 10.0, pace, self.console
        )
        self._stop = threading.Event()
        self._thread = threading.Thread(target=server.run, args=(self._stop.is_set,))
        self._thread.start()

    def say(self, *lines):
        """The last answer."""
        return json.loads(list(ask(self.console.url, lines))[-1])

    def wait_for(self, kind, wanted=lambda message: True):
        """The client's next message of this kind."""
        end_s = wall_s() + LIMIT_S
        while wall_s() < end_s:
            for message in self.flight.client.received():
                if message.get_type() == kind and wanted(message):
                    return message
        raise AssertionError(f"no {kind}")

    def close(self):
        self._stop.set()
        self._thread.join()
        self.console.close()


@pytest.fixture
def start(fly_mavlink):
    running = []

    def begin(**options):
        running.append(Running(fly_mavlink(), **options))
        return running[-1]

    yield begin
    for each in running:
        each.close()


def test_paused_time_stands_still_and_moves_by_whole_steps(start):
    run = start(paused=True)
    assert run.say("state") == {"time_s": 0.0, "paused": True, "speed": 1.0}
    assert run.say("step")["time_s"] == pytest.approx(1 / 300)
    assert run.say("step 29")["time_s"] == pytest.approx(0.1)
    assert run.say("run 0.5", "run 0.4") == {"time_s": 1.0, "paused": True, "speed": 1.0}
    assert run.say("resume")["paused"] is False
    while run.say("state")["time_s"] < 1.2:
        pass
    stopped_s = run.say("pause")["time_s"]
    assert run.say("state")["time_s"] == stopped_s


def test_the_speed_changes_in_flight(start):
    run = start(paused=True, speed=0.1)
    before_s, asked_s = run.say("speed 50", "resume")["time_s"], wall_s()
    while run.say("state")["time_s"] < before_s + 2.0:
        assert wall_s() < asked_s + LIMIT_S
    assert run.say("pause")["speed"] == 50.0


@pytest.mark.parametrize(
    "line",
    ["", "halt", "step -1", "step 0.5", "step x", "run 0", "speed 0", "speed 1000", "step nan"],
)
def test_what_is_no_command_is_refused_with_those_that_are(start, line):
    run = start(paused=True)
    assert "use pause, resume, step [COUNT]" in run.say(line)["error"]


def test_faults_come_the_same_way(start):
    run = start(paused=True)
    assert run.say('{"charge_norm": 0.5}') == {"time_s": 0.0}
    assert run.flight.autopilot.status.battery_norm == 0.5
    assert "unknown field" in run.say('{"charge": 0.5}')["error"]
    assert "at most" in run.say("x" * 5000)["error"]


def test_long_steps_are_ended_by_another_s_pause(start):
    run = start(paused=True)
    host, port = run.console.url.removeprefix("tcp://").split(":")
    with closing(socket.create_connection((host, int(port)))) as one:
        one.settimeout(LIMIT_S)
        one.sendall(b"run 100000\nstate\n")
        while run.say("state")["time_s"] == 0.0:
            pass
        ended_s = run.say("pause")["time_s"]
        stream = one.makefile()
        assert json.loads(stream.readline())["time_s"] == ended_s
        assert json.loads(stream.readline())["time_s"] == ended_s
    assert run.say("state")["time_s"] == ended_s


def test_a_paused_vehicle_still_beats_and_answers(start):
    run = start(paused=True)
    assert run.wait_for("HEARTBEAT").get_srcSystem() == 1
    assert run.wait_for("HEARTBEAT").get_srcSystem() == 1
    run.flight.client.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 148.0)
    assert run.wait_for("AUTOPILOT_VERSION") is not None
    assert run.say("state")["time_s"] == 0.0


@pytest.mark.parametrize("speed", [0.5, 1.0, 10.0, 50.0])
def test_all_clocks_tell_the_world_s_time_at_every_speed(start, speed):
    run = start(speed=speed)
    for _ in range(3):
        before_s = run.say("state")["time_s"]
        run.flight.client.received()
        run.flight.client.send(mavlink.MAVLink_timesync_message(0, 1))
        sync = run.wait_for("TIMESYNC", lambda message: message.ts1 == 1)
        run.flight.client.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 2.0)
        boot = run.wait_for("SYSTEM_TIME")
        after_s = run.say("state")["time_s"]
        slack_s = 0.001
        assert before_s - slack_s <= sync.tc1 * 1e-9 <= after_s + slack_s
        assert before_s - slack_s <= boot.time_boot_ms * 1e-3 <= after_s + slack_s


def test_lag_is_given_up_and_said_once_for_each_speed(caplog, monkeypatch):
    monkeypatch.setattr("sitl.pace.CALM_AFTER_S", -1.0)
    monkeypatch.setattr("sitl.pace.LAG_LIMIT_S", -1.0)
    pace = Pace(2.0)
    with caplog.at_level(logging.WARNING):
        pace.give_up_lag(0.0)
        pace.give_up_lag(0.0)
        pace.set_speed(3.0, 0.0)
        pace.give_up_lag(0.0)
    assert [record.message.split(" (")[0] for record in caplog.records] == [
        "this machine cannot keep up with speed 2",
        "this machine cannot keep up with speed 3",
    ]


def test_the_command_line_says_what_was_answered(start, capsys):
    run = start(paused=True)
    assert main(["control", run.console.url, "run 0.1", "state"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [json.loads(line)["time_s"] for line in lines] == pytest.approx([0.1, 0.1])
    assert main(["control", run.console.url, "nonsense"]) == 1


def test_a_wrong_address_is_one_clear_error(start):
    with pytest.raises(PlanError, match="use tcp://HOST:PORT"):
        list(ask("localhost:1", ["state"]))
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
    with pytest.raises(SimulatorError, match="refused"):
        list(ask(f"tcp://127.0.0.1:{port}", ["state"]))
