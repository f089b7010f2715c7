"""Where on Earth the flight is said to be: the option, the plan's key, and what clients see."""

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.settings import convert_settings
from sitl.cli import main
from sitl.mavlink.places import Origin
from sitl.options import read_settings
from sitl.settings import SitlSettings

ROOM = str(Path(__file__).parents[2] / "flightplans" / "rooms" / "room1.toml")
ZURICH = "47.397742,8.545594,488"


def test_the_option_replaces_the_plan_s_place(tmp_path):
    table = tmp_path / "sitl.toml"
    table.write_text("home = {latitude_deg = 1.0}\nparameters = {MIS_TAKEOFF_ALT = 1.5}\n")
    read = read_settings(table, ZURICH, ["COM_OBL_RC_ACT=5", "MIS_TAKEOFF_ALT=2"])
    chosen = convert_settings(read, SitlSettings, "sitl")
    assert chosen.home == Origin(latitude_deg=47.397742, longitude_deg=8.545594, amsl_m=488.0)
    assert chosen.parameters == {"MIS_TAKEOFF_ALT": 2.0, "COM_OBL_RC_ACT": 5.0}
    short = convert_settings(read_settings(None, "-33.5,151.2"), SitlSettings, "sitl").home
    assert (short.latitude_deg, short.amsl_m) == (-33.5, Origin().amsl_m)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--home", "47"], "--home 47: not LAT,LON or LAT,LON,ALT"),
        (["--home", "a,b"], "--home a,b: not LAT,LON"),
        (["--home", "91,0"], "sitl: home.latitude_deg: Expected `float` <= 85.0"),
        (["--home", "nan,0"], "sitl: home.latitude_deg"),
        (["--param", "X"], "--param X: not NAME=VALUE"),
        (["--param", "MIS_TAKEOF_ALT=1"], "did you mean 'MIS_TAKEOFF_ALT'?"),
    ],
)
def test_a_wrong_word_is_one_line_and_exit_code_2(capsys, words, said):
    links = ["--mavlink", "udpin://127.0.0.1:0", "--camera", "tcp://127.0.0.1:0"]
    assert main(["run", ROOM, *links, *words]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


@given(st.floats(-80, 80), st.floats(-179, 179), st.floats(-5000, 5000), st.floats(-5000, 5000))
def test_degrees_and_metres_are_each_other_s_inverse(latitude, longitude, north_m, east_m):
    origin = Origin(latitude_deg=latitude, longitude_deg=longitude)
    back = origin.level_m(*origin.degrees((north_m, east_m, 0.0)))
    assert back == pytest.approx((north_m, east_m), abs=1e-5)


def test_clients_see_the_place_and_heights_count_from_home(fly_mavlink):
    origin = Origin(latitude_deg=47.397742, longitude_deg=8.545594, amsl_m=488.0)
    flight = fly_mavlink(origin=origin)
    latest = {message.get_type(): message for message in flight.run(3.0)}
    home = latest["HOME_POSITION"]
    assert (home.latitude, home.longitude) == (473977420, 85455940)
    assert home.altitude == pytest.approx(488_000, abs=1)
    here = latest["GLOBAL_POSITION_INT"]
    assert (here.lat, here.lon) == pytest.approx((473977420, 85455940), abs=30)
    flight.take_off()
    set_home = (mavlink.MAV_CMD_DO_SET_HOME, 0, math.nan, math.nan, math.nan)
    assert flight.acks(*set_home, 47.397742, 8.545594, 489.0) == [0]
    go = (-1.0, 1.0, 0.0, math.nan)
    frame = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
    unset = 2**31 - 1
    flight.client.send(
        mavlink.MAVLink_command_int_message(1, 1, frame, 192, 0, 0, *go, unset, unset, 1.0)
    )
    flight.run(8.0)
    assert flight.autopilot.estimate.position_ned_m[2] == pytest.approx(-2.0, abs=0.1)
    latest = {message.get_type(): message for message in flight.run(1.0)}
    assert latest["GLOBAL_POSITION_INT"].relative_alt == pytest.approx(1000, abs=100)


def test_a_client_moves_the_origin(fly_mavlink):
    flight = fly_mavlink()
    flight.run(3.0)

    def answered(latitude, longitude, altitude):
        flight.client.received()
        flight.client.send(
            mavlink.MAVLink_set_gps_global_origin_message(1, latitude, longitude, altitude)
        )
        (answer,) = flight.answers("GPS_GLOBAL_ORIGIN")
        return answer.latitude, answer.longitude, answer.altitude

    place = (473977420, 85455940, 488_000)
    assert answered(*place) == place
    assert answered(950_000_000, 0, 0) == place  # no place on Earth
    latest = {message.get_type(): message for message in flight.run(2.1)}
    here = latest["GLOBAL_POSITION_INT"]
    assert (here.lat, here.lon) == pytest.approx(place[:2], abs=30)
    assert latest["HOME_POSITION"].altitude == pytest.approx(488_000, abs=1)
