"""MAVSDK, as its users have it, against ``sitl run`` in its own process: parameters and camera."""

import json
import subprocess
import sys
from pathlib import Path
from queue import Queue

import pytest
from mavsdk.plugins.camera import Camera
from mavsdk.plugins.param import Param, ParamError
from pymavlink import mavutil

from sitl.autopilot.parameters import PARAMETERS
from sitl.process import reserved_mavlink_port

ROOM = str(Path(__file__).parents[2] / "flightplans" / "rooms" / "room1.toml")
LIMIT_S = 20.0


@pytest.fixture(scope="module")
def vehicle(tmp_path_factory):
    """(its first ready line, MAVSDK's system, the parameter file); the second link is TCP."""
    from mavsdk import ComponentType, Configuration, Mavsdk

    saved = tmp_path_factory.mktemp("sitl") / "saved.params"
    with reserved_mavlink_port() as port:
        links = ["--mavlink", f"udpout://127.0.0.1:{port}", "tcpin://127.0.0.1:0"]
        words = [*links, "--camera", "tcp://127.0.0.1:0", "--parameters", str(saved)]
        with subprocess.Popen(
            [sys.executable, "-m", "sitl", "run", ROOM, *words, "--until-stdin-closes"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        ) as process:
            ready = json.loads(process.stdout.readline())
            client = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
            client.add_any_connection(f"udpin://127.0.0.1:{port}")
            yield ready, client.first_autopilot(LIMIT_S), saved
            client.destroy()
            process.stdin.close()
            assert process.wait(LIMIT_S) == 0


def test_mavsdk_lists_reads_and_sets_parameters(vehicle):
    parameters = Param(vehicle[1])
    listed = parameters.get_all_params()
    names = [p.name for p in (*listed.int_params, *listed.float_params)]
    assert sorted(names) == sorted(PARAMETERS)
    assert parameters.get_param_float("MIS_TAKEOFF_ALT") == 2.5
    parameters.set_param_float("MIS_TAKEOFF_ALT", 1.25)
    assert parameters.get_param_float("MIS_TAKEOFF_ALT") == 1.25
    parameters.set_param_int("COM_OBL_RC_ACT", 5)
    assert parameters.get_param_int("COM_OBL_RC_ACT") == 5
    with pytest.raises(ParamError):
        parameters.get_param_float("NO_SUCH_NAME")
    parameters.destroy()


def test_mavsdk_finds_the_camera_and_its_frames(vehicle):
    ready, system, _ = vehicle
    camera, lists, streams = Camera(system), Queue(), Queue()
    camera.subscribe_camera_list(lambda cameras, _: lists.put(cameras.cameras))
    camera.subscribe_video_stream_info(lambda update, _: streams.put(update.video_stream_info))
    while not (cameras := lists.get(timeout=LIMIT_S)):
        pass
    (found,) = cameras
    assert (found.horizontal_resolution_px, found.vertical_resolution_px) == (128, 96)
    assert streams.get(timeout=LIMIT_S).settings.uri == ready["camera"]
    camera.destroy()


def test_pymavlink_over_tcp_fetches_sets_and_saves(vehicle):
    ready, _, saved = vehicle
    host, port = ready["mavlink"][1].removeprefix("tcpin://").split(":")
    link = mavutil.mavlink_connection(f"tcp:{host}:{port}", source_system=254)
    assert link.wait_heartbeat(timeout=LIMIT_S).autopilot == mavutil.mavlink.MAV_AUTOPILOT_PX4
    link.mav.param_request_list_send(1, 1)
    answer = link.recv_match(type="PARAM_VALUE", blocking=True, timeout=LIMIT_S)
    assert (answer.param_id, answer.param_count) == ("_HASH_CHECK", len(PARAMETERS))
    link.param_set_send("MPC_XY_P", 0.8)
    while answer.param_id != "MPC_XY_P" or answer.param_value == pytest.approx(0.95):
        answer = link.recv_match(type="PARAM_VALUE", blocking=True, timeout=LIMIT_S)
    assert answer.param_value == pytest.approx(0.8)
    save = (mavutil.mavlink.MAV_CMD_PREFLIGHT_STORAGE, 0, 1, 0, 0, 0, 0, 0, 0)
    link.mav.command_long_send(1, 1, *save)
    assert link.recv_match(type="COMMAND_ACK", blocking=True, timeout=LIMIT_S).result == 0
    link.close()
    assert "1\t1\tMPC_XY_P\t0.8" in saved.read_text()
