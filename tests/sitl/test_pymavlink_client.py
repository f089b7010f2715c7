"""A plain pymavlink script, as its users write them, against ``sitl run`` in its own process."""

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest
from pymavlink import mavutil

ROOM = str(Path(__file__).parents[2] / "flightplans" / "rooms" / "office.toml")
LIMIT_S = 30.0
POSITION_ONLY, VELOCITY_ONLY = 0x0DF8, 0x0DC7
MAVLINK = mavutil.mavlink


@pytest.fixture(scope="module")
def link():
    words = ["--mavlink", "tcpin://127.0.0.1:0", "--camera", "tcp://127.0.0.1:0", "--speed", "5"]
    with subprocess.Popen(
        [sys.executable, "-m", "sitl", "run", ROOM, *words, "--until-stdin-closes"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as process:
        url = json.loads(process.stdout.readline())["mavlink"][0]
        link = mavutil.mavlink_connection(url.replace("tcpin://", "tcp:"), source_system=255)
        link.wait_heartbeat(timeout=LIMIT_S)
        link.mav.heartbeat_send(MAVLINK.MAV_TYPE_GCS, MAVLINK.MAV_AUTOPILOT_INVALID, 0, 0, 0)
        yield link
        link.close()
        process.stdin.close()
        assert process.wait(LIMIT_S) == 0


def command(link, number, *parameters):
    link.mav.command_long_send(1, 1, number, 0, *parameters, *(0.0,) * (7 - len(parameters)))
    return link.recv_match(type="COMMAND_ACK", blocking=True, timeout=LIMIT_S).result


def wait_for(link, kind, wanted):
    while (message := link.recv_match(type=kind, blocking=True, timeout=LIMIT_S)) is not None:
        if wanted(message):
            return message
    raise AssertionError(f"no such {kind}")


def stream_until(link, mask, position, velocity, wanted):
    """Sends a setpoint for every position that is told, until one is wanted."""

    def answer(here):
        link.mav.set_position_target_local_ned_send(
            *(0, 1, 1, MAVLINK.MAV_FRAME_LOCAL_NED, mask),
            *(*position, *velocity, 0.0, 0.0, 0.0, 0.0, 0.0),
        )
        return wanted(here)

    return wait_for(link, "LOCAL_POSITION_NED", answer)


def near(place):
    return lambda here: math.dist((here.x, here.y, here.z), place) < 0.2


def test_modes_by_name_offboard_and_landing(link):
    wait_for(link, "HEARTBEAT", lambda beat: beat.system_status == MAVLINK.MAV_STATE_STANDBY)
    assert "LOITER" in link.mode_mapping()
    link.set_mode("LOITER")
    link.arducopter_arm()
    link.motors_armed_wait()
    # param7 counts from the sea: too low, so MIS_TAKEOFF_ALT is flown, as MAVProxy's users see
    link.recv_match(type="COMMAND_ACK")
    takeoff = (MAVLINK.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, math.nan, math.nan, math.nan, 3.0)
    assert command(link, *takeoff) == MAVLINK.MAV_RESULT_ACCEPTED
    text = wait_for(link, "STATUSTEXT", lambda text: "minimum" in text.text)
    assert text.text == "Using minimum takeoff altitude: 2.50 m"
    wait_for(link, "LOCAL_POSITION_NED", lambda here: here.z < -2.3)
    wait_for(link, "HEARTBEAT", lambda beat: beat.custom_mode == 0x03040000)
    goal = (1.0, -0.5, -1.5)
    stream_until(link, POSITION_ONLY, goal, (0, 0, 0), lambda here: True)
    link.set_mode("OFFBOARD")
    stream_until(link, POSITION_ONLY, goal, (0, 0, 0), near(goal))
    stream_until(
        link, VELOCITY_ONLY, (0, 0, 0), (-0.5, 0, 0), lambda here: abs(here.vx + 0.5) < 0.06
    )
    link.set_mode("RTL")
    link.motors_disarmed_wait()
    home = link.recv_match(type="LOCAL_POSITION_NED", blocking=True, timeout=LIMIT_S)
    assert math.hypot(home.x, home.y) < 0.3
    assert home.z > -0.2


def test_retries_are_answered_alike_and_done_once(link):
    position = (MAVLINK.MAV_CMD_DO_SET_HOME, 1.0)
    for confirmation in range(3):
        link.mav.command_long_send(1, 1, position[0], confirmation, 1.0, 0, 0, 0, 0, 0, 0)
        ack = link.recv_match(type="COMMAND_ACK", blocking=True, timeout=LIMIT_S)
        assert (ack.command, ack.result) == (position[0], MAVLINK.MAV_RESULT_ACCEPTED)
