"""A project of somebody else's, with our package installed: what its tests get and leave."""

import subprocess
import sys
import xml.etree.ElementTree as ET

import pytest

from companion.flightlog import FlightLog

pytest_plugins = "pytester"

ROOM = """
size_m = [6.0, 4.0, 3.0]
[start]
position_m = [-2.0, 0.0]
[surface]
north = { texture = "brick" }
east = { texture = "brick" }
south = { texture = "brick" }
west = { texture = "brick" }
floor = { texture = "concrete" }
ceiling = { texture = "paint" }
[[box]]
centre_m = [2.0, 1.0, 0.5]
size_m = [0.5, 0.5, 1.0]
texture = "cardboard"
"""


MISSIONS = """
import os
import signal
from pathlib import Path

import pytest


def children():
    return Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()


@pytest.mark.flight(room="hangar", seed=2)
class TestHangar:
    def test_to_the_wall(self, lockstep):
        lockstep.take_off(1.0)
        lockstep.fly_velocity(12.0, forward_m_s=0.5)
        lockstep.expect_clearance_m(0.3)

    def test_up_and_down(self, lockstep):
        lockstep.take_off(1.0)
        lockstep.land()
        lockstep.expect_no_collision()

    def test_death(self, sitl):
        os.kill(int(children()[0]), signal.SIGKILL)
        sitl.wait_until_hovering()


def test_nothing_is_left():
    assert children() == []
"""


@pytest.fixture(scope="module")
def missions(tmp_path_factory):
    """(the project's folder, lines that pytest printed)."""
    folder = tmp_path_factory.mktemp("project")
    rooms = folder / "flightplans" / "rooms"
    rooms.mkdir(parents=True)
    (rooms / "hangar.toml").write_text(ROOM)
    (folder / "test_mission.py").write_text(MISSIONS)
    command = [sys.executable, "-m", "pytest", "--rootdir", str(folder), "-p", "no:cacheprovider"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.stderr == ""
    return folder, pytest.LineMatcher(done.stdout.splitlines())


def test_each_mission_ends_as_it_should(missions):
    _, lines = missions
    lines.fnmatch_lines(
        [
            "*SimulatorError: the simulator died in flight (exit code -9)*",
            "*flight of sitl-1*",
            "*2 failed, 2 passed in *",
        ]
    )


def test_a_failed_flight_is_kept_and_named(missions):
    project, lines = missions
    folder = project / "flight-logs" / "test_mission.py-TestHangar-test_to_the_wall" / "lockstep-1"
    lines.fnmatch_lines(
        [
            "*NotMetError: clearance of 0.3 m not kept: -0.*",
            "*flight of lockstep-1*",
            f"log folder: {folder}",
            f"path: {folder}/path.svg",
            "collisions: 1",
            "least clearance: *",
            "last STATUSTEXTs: ",
            "*Takeoff detected",
        ]
    )
    kept = {path.name for path in folder.parent.parent.iterdir()}
    assert kept == {folder.parent.name, "test_mission.py-TestHangar-test_death"}
    log = FlightLog(folder / "card.mcap")
    assert not log.truncated
    assert log.columns("/mocap")["truth_collisions"][-1] == 1
    assert "Takeoff detected" in (folder / "statustexts.txt").read_text()


def test_the_path_is_drawn_over_the_room(missions):
    project, _ = missions
    (path,) = project.glob("flight-logs/*-test_to_the_wall/*/path.svg")
    kinds = [element.tag.rpartition("}")[2] for element in ET.parse(path).getroot()]
    assert kinds.count("polyline") == 1
    assert kinds.count("rect") == 3  # paper, walls, box
    assert kinds.count("circle") == 3  # start, end, contact


def test_a_run_that_flies_nothing_imports_nothing_of_it(pytester):
    pytester.makepyfile(
        """
        import sys

        def test_modules(pytestconfig):
            assert pytestconfig.pluginmanager.has_plugin("flightcard")
            loaded = {name.partition(".")[0] for name in sys.modules}
            assert not loaded & {"companion", "sitl", "mavsdk", "jsbsim", "numba", "cv2", "msgspec"}
        """
    )
    pytester.runpytest_subprocess().assert_outcomes(passed=1)
