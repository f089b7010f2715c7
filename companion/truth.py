"""What motion capture sees of a flight: into the log and the summary, never into a decision."""

import math

from companion.flightlog import FlightLogWriter, Topic
from companion.kernel.frames import Vector3
from companion.kernel.messages import MocapPose, Phase
from companion.kernel.protocols import MotionCapture

CELL_M = 0.5
"""Side of the cells of the ground plan by which a vehicle's coverage of a room is counted."""


class TruthAccount:
    """The running totals of one phase."""

    def __init__(self) -> None:
        self.collisions = 0
        self.distance_flown_m = 0.0
        self.cells: set[tuple[int, int]] = set()
        """(north, east) of the cells visited, in whole CELL_M from motion capture's origin."""


class TruthCounter:
    """Counts poses by the phase in which they came."""

    def __init__(self) -> None:
        self.accounts: dict[Phase, TruthAccount] = {}
        """By phase; the initial one includes the take-off, and ``DONE`` is the landing."""
        self.collisions: int | None = None
        self._minimum_clearance_m = math.inf
        self._landing = False
        self._position_ned_m: Vector3 | None = None

    @property
    def minimum_clearance_m(self) -> float | None:
        return None if self.collisions is None else self._minimum_clearance_m

    @property
    def distance_flown_m(self) -> float | None:
        """Along the path, take-off and landing included."""
        if self.collisions is None:
            return None
        return sum(account.distance_flown_m for account in self.accounts.values())

    def begin_landing(self) -> None:
        """From here on being close to a surface is what is wanted."""
        self._landing = True

    def count(self, pose: MocapPose, phase: Phase) -> None:
        account = self.accounts.setdefault(phase, TruthAccount())
        position_ned_m = pose.truth_position_ned_m
        before_ned_m = self._position_ned_m or position_ned_m
        account.collisions += pose.truth_collisions - (self.collisions or 0)
        account.distance_flown_m += math.dist(position_ned_m, before_ned_m)
        north_m, east_m, _ = position_ned_m
        account.cells.add((math.floor(north_m / CELL_M), math.floor(east_m / CELL_M)))
        self.collisions = pose.truth_collisions
        if not self._landing:
            self._minimum_clearance_m = min(self._minimum_clearance_m, pose.truth_clearance_m)
        self._position_ned_m = position_ned_m


class TruthRecorder(TruthCounter):
    """Moves poses from motion capture into the log; counts nothing where there is no capture."""

    def __init__(self, mocap: MotionCapture | None, log: FlightLogWriter) -> None:
        super().__init__()
        self._mocap = mocap
        self._log = log

    def record(self, phase: Phase) -> None:
        """Takes all poses since the last call."""
        if self._mocap is None:
            return
        for pose in self._mocap.drain():
            self.count(pose, phase)
            self._log.write(Topic.MOCAP, pose)
