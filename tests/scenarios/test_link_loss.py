"""The companion behind a bad link: what it does, and that the vehicle gets down."""

import asyncio
import math
from pathlib import Path

import pytest

from companion.flight import FlightOrder, fly_rig
from companion.kernel.messages import FlightMode
from companion.plan import load_plan, room_path
from sitl.build import build
from sitl.faults import Faults
from sitl.injection import inject
from sitl.lockstep import rig_of

OFFICE = Path(__file__).parents[2] / "flightplans" / "office.toml"
BRIEF = ("experiment.initial_s=10", "experiment.learning_s=0", "experiment.test_s=0")
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
    [
        "sitl.faults.link_loss_norm=0.3",
        "sitl.faults.link_latency_s=0.3",
        "sitl.faults.link_jitter_s=0.15",
    ],
)
def test_a_bad_link_is_flown_over(fly, override):
    flown = fly({}, override)
    assert (flown.summary.outcome, flown.summary.collisions) == ("flown", 0)
    assert set(flown.modes[10:]) == {FlightMode.OFFBOARD}


def test_the_same_seed_is_the_same_flight_behind_the_same_link(fly):
    bad = "sitl.faults.link_loss_norm=0.2", "sitl.faults.link_jitter_s=0.1"
    assert fly({}, *bad).log == fly({}, *bad).log


def test_a_second_without_the_link_is_a_stop_and_then_it_flies_on(fly):
    flown = fly({40: CUT, 50: CLEAR})
    assert (flown.summary.outcome, flown.summary.collisions) == ("flown", 0)
    assert flown.summary.frames == 10 * RATE_HZ
    assert flown.modes[-1] is FlightMode.OFFBOARD


@pytest.mark.parametrize("back", [{}, {90: CLEAR}], ids=["for good", "for 5 s"])
def test_a_lost_link_ends_the_flight_on_the_ground(fly, back):
    flown = fly({40: CUT, **back})
    assert flown.summary.outcome == "failed"
    assert "nothing from the autopilot for 2." in flown.summary.reason
    assert flown.lands_by_itself()


def test_a_clear_link_is_no_link_at_all(fly):
    assert fly({}).log == fly({5: CLEAR}).log


def test_a_bad_link_is_flown_over_through_mavsdk_too(start_companion):
    brief = [f"experiment.{text}" for text in ("initial_s=5", "learning_s=0", "test_s=0")]
    bad = [
        "sitl.faults.link_loss_norm=0.3",
        "sitl.faults.link_latency_s=0.3",
        "sitl.faults.link_jitter_s=0.1",
    ]
    words = [word for override in (*brief, *bad) for word in ("--set", override)]
    slowly = ("--speed", "4")  # MAVSDK repeats what is not answered in half a second of wall time
    companion = start_companion("sitl", *words, *slowly)
    code, lines = companion.wait()
    assert code == 0, lines
    summary, _ = companion.leaves()
    assert (summary["outcome"], summary["collisions"]) == ("flown", 0)
