"""Who may still command, how old data may grow, and what is done about it."""

import asyncio
from typing import NamedTuple

import pytest

from companion.flightlog import FlightLog, FlightLogWriter, FlightMetadata
from companion.flying.safety import SafetySettings
from companion.kernel.clock import let_others_run
from companion.kernel.errors import VehicleError
from companion.kernel.messages import Event, FlightMode, Setpoint, Telemetry
from companion.kernel.protocols import Rig
from companion.loops import Authority, Heartbeat, watch

OFFBOARD = Telemetry(armed=True, flight_mode=FlightMode.OFFBOARD)


def stamp_ns(time_s):
    return round(time_s * 1e9)


def test_authority_lasts_as_long_as_offboard():
    authority = Authority()
    for time_s in range(100):
        authority.check(OFFBOARD, stamp_ns(time_s))


@pytest.mark.parametrize(
    ("telemetry", "state"),
    [
        (Telemetry(armed=True, flight_mode=FlightMode.POSITION), "position"),
        (Telemetry(armed=True, flight_mode=FlightMode.LAND), "land"),
        (Telemetry(armed=False, flight_mode=FlightMode.OFFBOARD), "disarmed"),
    ],
)
def test_authority_is_lost_after_a_grace_time(telemetry, state):
    authority = Authority()
    for tenth in range(31):
        authority.check(telemetry, stamp_ns(tenth / 10))
    with pytest.raises(VehicleError, match=f"the autopilot left offboard mode: {state}"):
        authority.check(telemetry, stamp_ns(3.1))


def test_a_short_lapse_is_forgiven_again_and_again():
    authority, lost = Authority(), Telemetry(armed=True, flight_mode=FlightMode.HOLD)
    for time_s in range(0, 60, 4):
        authority.check(lost, stamp_ns(time_s))
        authority.check(lost, stamp_ns(time_s + 2))
        authority.check(OFFBOARD, stamp_ns(time_s + 3))


def test_telemetry_is_new_only_when_its_stamp_moves():
    heartbeat = Heartbeat(0.0)
    heartbeat.saw_telemetry(Telemetry(stamp_ns=5), 1.0)
    heartbeat.saw_telemetry(Telemetry(stamp_ns=5), 2.0)
    assert (heartbeat.telemetry_s, heartbeat.telemetry_stamp_ns) == (1.0, 5)


class HandClock:
    """Sleeping is all that moves it."""

    def __init__(self):
        self.time_s = 0.0

    def now_s(self):
        return self.time_s

    async def sleep(self, duration_s):
        self.time_s += duration_s
        await let_others_run()


class NotedVehicle:
    """Notes what it is told; its telemetry is as fresh as the clock."""

    def __init__(self, clock):
        self._clock = clock
        self.told = []
        self.said = []

    def telemetry(self):
        return Telemetry(stamp_ns=stamp_ns(self._clock.now_s()))

    async def send(self, setpoint):
        assert setpoint == Setpoint(stamp_ns=setpoint.stamp_ns)  # stands still
        self.told.append("stop")

    async def say(self, event):
        self.said.append(event.text)

    async def hold(self):
        self.told.append("hold")


class Watched(NamedTuple):
    told: list[str]
    said: list[str]
    events: list[Event]
    ended_s: float


@pytest.fixture
def watch_silence(tmp_path):
    """Watches a camera that says nothing until ``watch`` gives up."""

    def run(settings):
        clock = HandClock()
        vehicle = NotedVehicle(clock)
        with FlightLogWriter(
            tmp_path / "log.mcap", FlightMetadata(plan={}, seed=1, version="0")
        ) as log:
            rig = Rig(vehicle, None, clock)
            with pytest.raises(VehicleError, match=r"no new frame for 5\.\d s: landing"):
                asyncio.run(watch(rig, log, Heartbeat(0.0), settings))
        events = list(FlightLog(tmp_path / "log.mcap").read("/event", Event))
        return Watched(vehicle.told, vehicle.said, events, clock.now_s())

    return run


def test_silence_stops_then_holds_once_then_lands(watch_silence):
    watched = watch_silence(SafetySettings(stop_after_s=0.5, hold_after_s=2.0, land_after_s=5.0))
    assert watched.ended_s == pytest.approx(5.0, abs=0.15)
    assert watched.told.count("hold") == 1
    assert set(watched.told[:-1]) == {"stop"}
    assert 14 <= watched.told.count("stop") <= 16  # ten times a second from 0.5 to 2 s
    assert watched.said == [event.text for event in watched.events]
    named, *reactions = watched.said
    assert named == "camera: no frames; stopping (for 0.4 s)"
    assert [text.rpartition(": ")[2] for text in reactions] == ["stop", "hold", "land"]
