"""What motion capture sees of a flight: into the log and the summary, never into a decision."""

import math

from companion.flightlog import FlightLogWriter, Topic
from companion.kernel.protocols import MotionCapture


class TruthRecorder:
    """Moves poses from motion capture into the log; knows nothing where there is no capture."""

    def __init__(self, mocap: MotionCapture | None, log: FlightLogWriter) -> None:
        self._mocap = mocap
        self._log = log
        self._minimum_clearance_m = math.inf
        self._landing = False
        self.collisions: int | None = None

    @property
    def minimum_clearance_m(self) -> float | None:
        return None if self.collisions is None else self._minimum_clearance_m

    def begin_landing(self) -> None:
        """From here on being close to a surface is what is wanted."""
        self._landing = True

    def record(self) -> None:
        """Takes all poses since the last call."""
        if self._mocap is None:
            return
        for pose in self._mocap.drain():
            self.collisions = pose.truth_collisions
            if not self._landing:
                self._minimum_clearance_m = min(self._minimum_clearance_m, pose.truth_clearance_m)
            self._log.write(Topic.MOCAP, pose)
