"""The deadman's stages, by the clock; and that a blocked event loop cannot stop it."""

import asyncio
import sys
import threading
from asyncio.subprocess import PIPE
from pathlib import Path
from typing import NamedTuple

import pytest

from companion.kernel.clock import SimClock, WallClock, wall_s
from companion.kernel.errors import LinkError, VehicleError
from companion.kernel.messages import FlightMode, LandedState, Setpoint, SimulationRequest
from companion.vehicle.deadman import REPEAT_PERIOD_S, Deadman, DeadmanSettings, Stage
from companion.vehicle.mavsdk_vehicle import MavsdkSettings, MavsdkVehicle
from sitl.process import launch

ROOM = Path(__file__).parents[3] / "flightplans" / "rooms" / "room1.toml"
SETTINGS = DeadmanSettings(stop_after_s=0.5, hold_after_s=2.0, land_after_s=5.0)
LIMIT_S = 60.0
"""Only a deadman that never acts is waited for so long."""


class Actions:
    """Remembers what was asked, and lets the test wait for it."""

    def __init__(self, error=None):
        self.asked = []
        self._changed = threading.Condition()
        self.error = error

    def _ask(self, name):
        with self._changed:
            self.asked.append(name)
            self._changed.notify_all()
        if self.error is not None:
            raise self.error

    def stop(self):
        self._ask("stop")

    def hold(self):
        self._ask("hold")

    def land(self):
        self._ask("land")

    def wait_for(self, *names):
        self.wait_until(lambda asked: asked == list(names))

    def wait_until(self, true_of):
        with self._changed:
            assert self._changed.wait_for(lambda: true_of(self.asked), LIMIT_S), self.asked


class Watched(NamedTuple):
    """A deadman at work, and the two times that it goes by."""

    deadman: Deadman
    actions: Actions
    clock: SimClock
    wall: SimClock


@pytest.fixture
def watched():
    """Makes open deadmen and closes them after the test."""
    opened = []

    def make(error=None):
        actions, clock, wall = Actions(error), SimClock(), SimClock()
        deadman = Deadman(actions, clock, SETTINGS, wall.now_s)
        deadman.open()
        opened.append(deadman)
        return Watched(deadman, actions, clock, wall)

    yield make
    for deadman in opened:
        deadman.close()
    assert not [t for t in threading.enumerate() if t.name == "deadman"]


def looked_at():
    """Long enough for the deadman to have looked; a longer or shorter wait tells no lie."""
    threading.Event().wait(0.05)


def test_it_rests_until_it_is_fed(watched):
    deadman, actions, clock, wall = watched()
    clock.time_s = wall.time_s = 100.0
    looked_at()
    assert (deadman.stage, actions.asked) == (Stage.RESTING, [])


def test_silence_stops_holds_and_lands_once_each(watched):
    deadman, actions, clock, wall = watched()
    deadman.feed()
    clock.time_s = 0.6
    actions.wait_for("stop")
    for time_s, name in ((2.1, "hold"), (5.1, "land")):
        wall.time_s = time_s
        actions.wait_until(lambda asked, name=name: asked[-1] == name)
    assert actions.asked == ["stop", "hold", "land"]
    assert deadman.stage is Stage.LANDING


def test_the_vehicles_own_time_decides_about_stopping(watched):
    deadman, actions, clock, wall = watched()
    deadman.feed()
    wall.time_s = 1.9
    looked_at()
    assert actions.asked == []
    clock.time_s = 0.51
    actions.wait_for("stop")


def test_feeding_after_a_stop_goes_on(watched):
    deadman, actions, clock, _ = watched()
    deadman.feed()
    clock.time_s = 0.6
    actions.wait_for("stop")
    deadman.feed()
    assert deadman.stage is Stage.WATCHING
    clock.time_s = 1.2
    actions.wait_for("stop", "stop")


def test_what_failed_is_tried_again_until_it_works(watched):
    deadman, actions, clock, wall = watched(LinkError("gone"))
    deadman.feed()
    clock.time_s, wall.time_s = 0.6, 5.1
    actions.wait_for("land")
    wall.time_s += 1.1 * REPEAT_PERIOD_S
    actions.wait_for("land", "land")
    actions.error = None  # the link is back
    wall.time_s += 1.1 * REPEAT_PERIOD_S
    actions.wait_for("land", "land", "land")
    wall.time_s += 10.0 * REPEAT_PERIOD_S
    looked_at()
    assert actions.asked.count("land") == 3


def test_resting_ends_the_watch(watched):
    deadman, actions, clock, wall = watched()
    deadman.feed()
    deadman.rest()
    clock.time_s = wall.time_s = 100.0
    looked_at()
    assert actions.asked == []


def test_a_blocked_event_loop_stops_the_vehicle_and_lands_it(tmp_path):
    speed = 10.0
    request = SimulationRequest(
        room=str(ROOM), seed=1, speed=speed, camera_rate_hz=10.0, log_dir=str(tmp_path)
    )
    settings = MavsdkSettings(
        deadman=DeadmanSettings(stop_after_s=1.0, hold_after_s=1.0, land_after_s=1.2)
    )

    async def run():
        async with launch(request) as endpoints:
            clock = WallClock(speed)
            async with MavsdkVehicle(endpoints.mavlink_url, clock, settings) as vehicle:
                await vehicle.take_off(1.0)
                await vehicle.start_offboard(Setpoint(stamp_ns=0))
                ahead = Setpoint(stamp_ns=0, velocity_hfrd_m_s=(0.3, 0.0, 0.0))
                for _ in range(20):
                    await vehicle.send(ahead)
                    await clock.sleep(0.1)
                assert vehicle.telemetry().velocity_ned_m_s[0] != pytest.approx(0.0, abs=0.1)
                block_the_event_loop_until(lambda: stands(vehicle.telemetry()))
                assert vehicle.telemetry().flight_mode is FlightMode.OFFBOARD
                block_the_event_loop_until(
                    lambda: vehicle.telemetry().landed_state is LandedState.ON_GROUND
                )
                with pytest.raises(VehicleError, match="the deadman is LANDING"):
                    await vehicle.send(ahead)
                await vehicle.land()
                assert not vehicle.telemetry().armed

    asyncio.run(run())


HUNG = """
import asyncio, ctypes, sys
from companion.kernel.clock import WallClock
from companion.kernel.messages import Setpoint
from companion.vehicle.deadman import DeadmanSettings
from companion.vehicle.mavsdk_vehicle import MavsdkSettings, MavsdkVehicle

async def run(url, speed):
    clock = WallClock(speed)
    settings = MavsdkSettings(deadman=DeadmanSettings(exit_after_s=0.5))
    async with MavsdkVehicle(url, clock, settings) as vehicle:
        await vehicle.take_off(1.0)
        await vehicle.start_offboard(Setpoint(stamp_ns=0))
        await vehicle.send(Setpoint(stamp_ns=0, velocity_hfrd_m_s=(0.3, 0.0, 0.0)))
        ctypes.PyDLL(None).sleep(60)  # with Python's lock held, as a bad driver would

asyncio.run(run(sys.argv[1], float(sys.argv[2])))
"""


def test_what_blocks_python_as_a_whole_ends_the_process_and_the_setpoints(tmp_path):
    speed = 10.0
    request = SimulationRequest(
        room=str(ROOM), seed=1, speed=speed, camera_rate_hz=10.0, log_dir=str(tmp_path)
    )

    async def run():
        async with launch(request) as endpoints:
            hung = await asyncio.create_subprocess_exec(
                *(sys.executable, "-c", HUNG, endpoints.mavlink_url, str(speed)), stderr=PIPE
            )
            _, said = await hung.communicate()
            return hung.returncode, said.decode()

    code, said = asyncio.run(run())
    assert code == 1
    assert said.startswith("Timeout (0:00:00.5")
    assert "in run" in said  # the trace shows where it hung


def stands(telemetry):
    return max(map(abs, telemetry.velocity_ned_m_s)) < 0.1


def block_the_event_loop_until(reached):
    """As code that computes for too long would; other threads get their turns."""
    given_up_s = wall_s() + 30.0
    while not reached():
        assert wall_s() < given_up_s
