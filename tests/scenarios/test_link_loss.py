"""The companion behind a bad link, in lockstep: what it does, and that the vehicle gets down."""

import asyncio
import math
from pathlib import Path

import pytest

from companion.flight import FlightOrder, fly_rig
from companion.kernel.messages import FlightMode
from companion.plan import load_plan, room_path
from sitl.build import build
from sitl.faults import Faults, inject
from sitl.lockstep import rig_of

OFFICE = Path(__file__).parents[2] / "flightplans" / "office.toml"
BRIEF = ("experiment.initial_s=20", "experiment.learning_s=0", "experiment.test_s=0")
CUT, CLEAR = {"link_loss_norm": 1.0}, {"link_loss_norm": 0.0}
RATE_HZ = 10


class Flown:
    """A flight of the office with faults by frame number, and what came of it."""

    def __init__(self, log_dir, faults, overrides=()):
        plan = load_plan(OFFICE, (*BRIEF, *overrides))
        room = room_path(plan, OFFICE)
        simulation = build(room, plan.sitl, plan.seed, plan.camera.rate_hz)
        self.world = simulation.world
        self.modes, self.speeds_m_s = [], []
        self._faults = dict(faults)
        order = FlightOrder(plan=plan, plan_path=OFFICE, vehicle="lockstep", log_dir=log_dir)
        self.summary = asyncio.run(fly_rig(order, rig_of(simulation), self._observe))
        self.log = (log_dir / "flight.mcap").read_bytes()

    def _observe(self, step, pipeline):
        world = self.world
        self.modes.append(world.autopilot.status.mode)
        self.speeds_m_s.append(math.hypot(*world.truth.velocity_ned_m_s[:2]))
        if len(self.modes) in self._faults:
            inject(world, Faults(**self._faults.pop(len(self.modes))))

    def lands_by_itself(self):
        world = self.world
        world.advance_to(world.time_s + 60.0)
        return not world.autopilot.status.armed and world.collisions == 0


@pytest.fixture
def fly(tmp_path):
    folders = iter("abc")

    def fly(faults, *overrides):
        log_dir = tmp_path / next(folders)
        log_dir.mkdir()
        return Flown(log_dir, faults, overrides)

    return fly


@pytest.mark.parametrize(
    "override",
    ["sitl.link.loss_norm=0.3", "sitl.link.latency_s=0.3", "sitl.link.jitter_s=0.15"],
)
def test_a_bad_link_is_flown_over(fly, override):
    one, same = fly({}, override), fly({}, override)
    assert (one.summary.outcome, one.summary.collisions) == ("flown", 0)
    assert set(one.modes[10:]) == {FlightMode.OFFBOARD}
    assert one.log == same.log


def test_a_second_without_the_link_is_a_stop_and_then_it_flies_on(fly):
    flown = fly({50: CUT, 60: CLEAR})
    assert (flown.summary.outcome, flown.summary.collisions) == ("flown", 0)
    assert flown.summary.frames == 20 * RATE_HZ
    assert flown.modes[-1] is FlightMode.OFFBOARD


@pytest.mark.parametrize("back", [{}, {100: CLEAR}], ids=["for good", "for 5 s"])
def test_a_lost_link_ends_the_flight_on_the_ground(fly, back):
    flown = fly({50: CUT, **back})
    assert flown.summary.outcome == "failed"
    assert "nothing from the autopilot for 2." in flown.summary.reason
    assert flown.lands_by_itself()


def test_a_clear_link_is_no_link_at_all(fly):
    assert fly({}).log == fly({5: CLEAR}).log
