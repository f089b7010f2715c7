"""What motion capture's poses add up to, by phase."""

import math

import pytest

from companion.flightlog import FlightLog, FlightLogWriter, FlightMetadata
from companion.kernel.messages import MocapPose, Phase
from companion.truth import TruthRecorder


class Capture:
    """Poses told beforehand, handed out once."""

    def __init__(self):
        self.poses = []

    def see(self, north_m, east_m, down_m=-1.0, collisions=0, clearance_m=1.0):
        pose = MocapPose(
            stamp_ns=len(self.poses),
            truth_position_ned_m=(north_m, east_m, down_m),
            truth_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
            truth_clearance_m=clearance_m,
            truth_collisions=collisions,
        )
        self.poses.append(pose)

    def drain(self):
        poses, self.poses = self.poses, []
        return poses


@pytest.fixture
def log(tmp_path):
    with FlightLogWriter(
        tmp_path / "flight.mcap", FlightMetadata(plan={}, seed=1, version="")
    ) as log:
        yield log


def test_distance_collisions_and_cells_go_to_the_phase_they_fall_in(log):
    capture = Capture()
    truth = TruthRecorder(capture, log)
    for east_m in (0.1, 0.4):
        capture.see(0.1, east_m)
    truth.record(Phase.LEARNING)
    for east_m, collisions in ((0.6, 1), (-0.1, 1), (-0.4, 3)):
        capture.see(0.1, east_m, collisions=collisions, clearance_m=east_m)
    truth.record(Phase.TEST)
    learning, test = (truth.accounts[phase] for phase in (Phase.LEARNING, Phase.TEST))
    assert (learning.collisions, test.collisions, truth.collisions) == (0, 3, 3)
    assert learning.distance_flown_m == pytest.approx(0.3)
    assert test.distance_flown_m == pytest.approx(0.2 + 0.7 + 0.3)
    assert truth.distance_flown_m == pytest.approx(1.5)
    assert learning.cells == {(0, 0)}
    assert test.cells == {(0, 1), (0, -1)}
    assert truth.minimum_clearance_m == -0.4
    log.close()
    assert FlightLog(log.path).topics()["/mocap"] == 5


def test_distance_is_along_the_path_in_all_three_axes(log):
    capture = Capture()
    truth = TruthRecorder(capture, log)
    for down_m in (0.0, -1.0, 0.0):
        capture.see(0.0, 0.0, down_m)
    capture.see(3.0, 4.0, 0.0)
    truth.record(Phase.TEST)
    assert truth.distance_flown_m == pytest.approx(2.0 + math.hypot(3.0, 4.0))


def test_without_motion_capture_nothing_is_known(log):
    truth = TruthRecorder(None, log)
    truth.record(Phase.TEST)
    assert (truth.collisions, truth.distance_flown_m, truth.minimum_clearance_m) == (None,) * 3
    assert truth.accounts == {}
