"""What a user writes: plans, rooms, campaigns, calibrations, parameters, keys."""

import shutil
from pathlib import Path

import pytest

from companion.camera.spec import load_calibration
from companion.kernel.messages import Telemetry
from companion.kernel.settings import convert_settings
from companion.pipeline import Pipeline
from companion.plan import load_plan, room_path
from sitl.arena.contact import RoomContact
from sitl.arena.room import load_room
from sitl.mavlink.parameter_file import ParameterFile
from sitl.mavlink.signing import read_key
from sitl.options import read_settings
from sitl.settings import SitlSettings
from tools.campaign.plan import load_campaign

PLANS = Path(__file__).parents[2] / "flightplans"
CALIBRATION = b"""width_px = 128
height_px = 96
baseline_m = 0.06
left = { focal_x_px = 100.0, focal_y_px = 100.0, centre_x_px = 64.0, centre_y_px = 48.0 }
right = { focal_x_px = 100.0, focal_y_px = 100.0, centre_x_px = 64.0, centre_y_px = 48.0 }
"""


def contents(pattern):
    return [path.read_bytes() for path in sorted(PLANS.glob(pattern))]


def test_plans(fuzz, tmp_path, camera, pair):
    (tmp_path / "rooms").symlink_to(PLANS / "rooms")
    path = tmp_path / "mine.toml"

    def run(data):
        path.write_bytes(data)
        plan = load_plan(path)
        room_path(plan, path)
        convert_settings(plan.sitl, SitlSettings, "sitl")
        Pipeline(plan, camera).step(pair, Telemetry(stamp_ns=0))

    fuzz(run, contents("*.toml"))


def test_overrides(fuzz):
    def run(data):
        load_plan(None, [data.decode(errors="replace")])

    keys = b"experiment.scheme=dagger", b"sitl.wind_ned_m_s=[1, 0, 0]", b"seed = 9", b"a.b.c=true"
    fuzz(run, keys)


def test_rooms(fuzz, tmp_path):
    path = tmp_path / "mine.toml"

    def run(data):
        path.write_bytes(data)
        RoomContact(load_room(path)).nearest((0.1, 0.1, -1.0))

    fuzz(run, contents("rooms/*.toml"))


def test_campaigns(fuzz, tmp_path):
    shutil.copytree(PLANS, tmp_path / "flightplans")
    path = tmp_path / "flightplans" / "campaigns" / "mine.toml"

    def run(data):
        path.write_bytes(data)
        load_campaign(path, runs=1)

    fuzz(run, contents("campaigns/*.toml"))


def test_calibrations(fuzz, tmp_path):
    path = tmp_path / "camera.toml"

    def run(data):
        path.write_bytes(data)
        load_calibration(path)

    fuzz(run, [CALIBRATION])


@pytest.mark.parametrize("suffix", [".toml", ".json"])
def test_simulator_settings(fuzz, tmp_path, suffix):
    path = tmp_path / f"sitl{suffix}"

    def run(data):
        path.write_bytes(data)
        convert_settings(read_settings(path), SitlSettings, "sitl")

    fuzz(run, [b'{"battery": {"charge_norm": 0.5}}', b"[battery]\ncharge_norm = 0.5\n", b"[]"])


def test_parameter_files(fuzz, tmp_path):
    path = tmp_path / "saved.params"
    saved = ParameterFile(path)
    saved.save(saved.last)
    seed = path.read_bytes()

    def run(data):
        path.write_bytes(data)
        ParameterFile(path)

    fuzz(run, [seed, b"1 1 MPC_XY_P 0.8 9\n"])


def test_signing_keys(fuzz, tmp_path):
    path = tmp_path / "key"

    def run(data):
        path.write_bytes(data)
        read_key(path)

    fuzz(run, [bytes(range(32)), bytes(range(32)).hex().encode()])
