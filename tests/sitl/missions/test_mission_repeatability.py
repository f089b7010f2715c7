"""The missions that ship, flown twice through MAVLink in lockstep: the same telemetry log."""

import json
import math
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.messages import FlightMode
from sitl.autopilot.interface import Ack
from sitl.mavlink.tlog import TelemetryLog

PLANS = sorted((Path(__file__).parents[3] / "flightplans").glob("*.plan"))
LONGEST_S = 120.0


def items_of(plan):
    """The mission of a QGroundControl file as it goes over the link."""
    for number, item in enumerate(json.loads(plan.read_text())["mission"]["items"]):
        *params, x, y, z = (math.nan if value is None else value for value in item["params"])
        placed = item["frame"] != mavlink.MAV_FRAME_MISSION
        scale = 1e7 if placed else 1.0
        yield mavlink.MAVLink_mission_item_int_message(
            *(1, 1, number, item["frame"], item["command"], 0, int(item["autoContinue"])),
            *map(float, params),
            *(round(x * scale), round(y * scale), float(z)),
        )


def upload(flight, items):
    flight.client.received()
    flight.client.send(mavlink.MAVLink_mission_count_message(1, 1, len(items)))
    while True:
        flight.server.poll()
        for message in flight.client.received():
            if message.get_type() == "MISSION_ACK":
                return message.type
            if message.get_type() == "MISSION_REQUEST_INT":
                flight.client.send(items[message.seq])


def flown(fly_mavlink, plan, path):
    """The log of one flight of this mission, from upload to landing."""
    flight = fly_mavlink(log=TelemetryLog(path))
    flight.run(3.0)
    assert upload(flight, list(items_of(plan))) == mavlink.MAV_MISSION_ACCEPTED
    assert flight.acks(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == [Ack.ACCEPTED]
    assert flight.autopilot.set_mode(FlightMode.MISSION) is Ack.ACCEPTED
    while flight.autopilot.status.armed and flight.world.time_s < LONGEST_S:
        flight.run(1.0)
    flight.server.close()
    assert not flight.autopilot.status.armed
    assert flight.world.distance_flown_m > 5.0
    return path.read_bytes()


@pytest.mark.parametrize("plan", PLANS, ids=lambda plan: plan.stem)
def test_two_flights_of_a_mission_leave_the_same_log(fly_mavlink, plan, tmp_path):
    one, other = (flown(fly_mavlink, plan, tmp_path / name) for name in ("one", "other"))
    assert one == other
    assert len(one) > 100_000
