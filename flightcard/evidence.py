"""What a flight leaves for whoever must find out why a test failed."""

from collections.abc import Sequence
from pathlib import Path

import msgspec

from companion import __version__
from companion.flightlog import FlightLogWriter, FlightMetadata, Topic
from companion.kernel.messages import Event, MocapPose, Telemetry
from companion.kernel.protocols import MotionCapture
from flightcard.machines import Text
from flightcard.order import Order
from flightcard.picture import draw_path
from sitl.arena.room import load_room

LOG_NAME = "card.mcap"
PATH_NAME = "path.svg"
TEXTS_NAME = "statustexts.txt"
TAIL_LINES = 10
FLYING_M = 0.1
"""Higher than this above where it stood first, the vehicle flies."""


class Evidence:
    """Truth, texts and log of one vehicle; itself a ``MotionCapture``, so that a flight that drains
    the poses leaves them here as well.
    """

    def __init__(self, name: str, order: Order, mocap: MotionCapture, folder: Path) -> None:
        self.name = name
        self.folder = folder
        self.path: list[MocapPose] = []
        self.texts: list[tuple[float, str]] = []
        """(time in s, STATUSTEXT); in lockstep when it was said, else when it was heard."""
        self.nearest: MocapPose | None = None
        """The pose with the least clearance in flight."""
        self._room = Path(order.request.room)
        self._mocap = mocap
        plan = msgspec.to_builtins(order.plan)
        metadata = FlightMetadata(plan=plan, seed=order.request.seed, version=__version__)
        self._log = FlightLogWriter(folder / LOG_NAME, metadata)

    def drain(self) -> Sequence[MocapPose]:
        poses = self._mocap.drain()
        for pose in poses:
            self._log.write(Topic.MOCAP, pose)
            self.path.append(pose)
            self._judge(pose)
        return poses

    def note(self, telemetry: Telemetry, texts: Sequence[Text]) -> None:
        """To be called after whatever the vehicle did."""
        self.drain()
        self._log.write(Topic.TELEMETRY, telemetry)
        for text, said_s in texts:
            time_s = telemetry.stamp_ns * 1e-9 if said_s is None else said_s
            self.texts.append((time_s, text))
            event = Event(stamp_ns=round(time_s * 1e9), severity="info", text=text)
            self._log.write(Topic.EVENT, event)

    def leave(self) -> None:
        """Closes the log, and writes what a person looks at first."""
        self._log.close()
        lines = (f"{time_s:8.2f} s  {text}\n" for time_s, text in self.texts)
        (self.folder / TEXTS_NAME).write_text("".join(lines), encoding="utf-8")
        (self.folder / PATH_NAME).write_text(
            draw_path(load_room(self._room), self.path), encoding="utf-8"
        )

    def report(self) -> str:
        """For the test's report."""
        lines = [f"log folder: {self.folder}", f"path: {self.folder / PATH_NAME}"]
        if self.path:
            last = self.path[-1]
            place = ", ".join(f"{axis:.2f}" for axis in last.truth_position_ned_m)
            lines.append(f"last at ({place}) m NED, {last.stamp_ns * 1e-9:.2f} s")
            lines.append(f"collisions: {last.truth_collisions}")
        if self.nearest is not None:
            lines.append(f"least clearance: {describe_clearance(self.nearest)}")
        lines.append(f"last STATUSTEXTs: {'' if self.texts else 'none'}")
        lines += [f"  {time_s:8.2f} s  {text}" for time_s, text in self.texts[-TAIL_LINES:]]
        return "\n".join(lines)

    def _judge(self, pose: MocapPose) -> None:
        height_m = self.path[0].truth_position_ned_m[2] - pose.truth_position_ned_m[2]
        if height_m > FLYING_M and (
            self.nearest is None or pose.truth_clearance_m < self.nearest.truth_clearance_m
        ):
            self.nearest = pose


def describe_clearance(pose: MocapPose) -> str:
    north_m, east_m, _ = pose.truth_position_ned_m
    return (
        f"{pose.truth_clearance_m:.2f} m at {pose.stamp_ns * 1e-9:.2f} s, "
        f"{north_m:.2f} m north, {east_m:.2f} m east"
    )
