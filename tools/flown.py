"""A flight as its log tells it, for the tools that draw and count."""

from collections.abc import Iterable
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from companion.flightlog import Columns, FlightLog, Topic
from companion.flying.switch import Choice, caution_px
from companion.judging.scorecard import Scorecard
from companion.kernel.errors import PlanError, RecordingError
from companion.kernel.messages import Decision, Percept, Phase
from companion.kernel.settings import convert_settings
from companion.logfolder import LOG_NAME
from companion.plan import Plan
from sitl.arena.room import Room, load_room
from tools.logs.recover import RECOVERED_SUFFIX

T = TypeVar("T")

ROOMS = Path(__file__).parents[1] / "flightplans" / "rooms"


class FlownFlight:
    """One flight as its log tells it. Raises RecordingError, here or where a part is missing."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.log = FlightLog(path)
        if not {Topic.DECISION, Topic.PERCEPT} <= set(self.log.topics()):
            raise RecordingError(f"{path}: nothing was flown")
        self.decision, self.percept = _together(*self.log.tables(Topic.DECISION, Topic.PERCEPT))

    @property
    def name(self) -> str:
        """The log folder's name, which says when, what and with which seed."""
        return self.path.resolve().parent.name if self.path.name == LOG_NAME else self.path.stem

    @cached_property
    def plan(self) -> Plan:
        """The plan as it was flown; a log without one had all defaults."""
        return convert_settings(dict(self.log.metadata.plan), Plan, f"{self.path}: plan")

    @property
    def room_name(self) -> str:
        return Path(self.plan.room).stem

    @cached_property
    def time_s(self) -> NDArray[np.float64]:
        """Since the first frame."""
        stamp_ns = self.percept["stamp_ns"]
        return np.asarray((stamp_ns - stamp_ns[0]) * 1e-9)

    @property
    def has_truth(self) -> bool:
        return bool(self.log.topics().get(Topic.MOCAP))

    @cached_property
    def truth(self) -> Columns:
        """The motion capture's record nearest to each frame. Raises RecordingError without any."""
        if not self.has_truth:
            raise RecordingError(f"{self.path}: no truth: nothing on {Topic.MOCAP}")
        return self.log.nearest(Topic.MOCAP, self.decision["stamp_ns"])

    @cached_property
    def places_m(self) -> NDArray[np.float64]:
        """(n_frames, 2): north and east; the truth where it is known, else the estimate."""
        if self.has_truth:
            return self.truth["truth_position_ned_m"][:, :2]
        at_ns, known_ns = self.decision["stamp_ns"], self.log.log_times_ns(Topic.TELEMETRY)
        place_m = self.log.columns(Topic.TELEMETRY)["position_ned_m"]
        return np.stack([np.interp(at_ns, known_ns, place_m[:, axis]) for axis in (0, 1)], axis=1)

    def in_phase(self, phase: str) -> NDArray[np.bool_]:
        """(n_frames,); ``phase`` may be "all"."""
        return np.asarray((self.decision["phase"] == phase) | (phase == "all"))

    @cached_property
    def approach(self) -> NDArray[np.int64]:
        """(n_frames,): number of the approach or of the turn after it, 1 for the first."""
        straight = self.decision["state"] == "straight"
        return np.cumsum(straight & ~np.append(False, straight[:-1]))

    def mono_threshold_px(self, phase: str) -> float:
        """Above which mono turned in this phase; the plan's fixed one where mono never flew."""
        mono = (self.decision["cue"] == "mono") & self.in_phase(phase)
        if mono.any():
            return float(self.decision["threshold_px"][mono][-1])
        return self.plan.learner.fixed_threshold_px(self.plan.behaviour.turn_threshold_px)

    @property
    def flew_mono_in_test(self) -> bool:
        return bool((self.in_phase(Phase.TEST) & (self.decision["cue"] == "mono")).any())

    @cached_property
    def scorecard(self) -> Scorecard:
        """The flight's own counts, made anew from its records."""
        card = Scorecard(self.plan.behaviour.turn_threshold_px)
        thresholds_px = {phase: self.mono_threshold_px(phase) for phase in Phase}
        caution_std = self.plan.learner.caution_std
        percepts = self._records(self.percept, Percept)
        for percept, d in zip(percepts, self._records(self.decision, Decision), strict=True):
            choice = Choice(d.cue, d.override, d.disparity_px, d.threshold_px, None)
            added_px = caution_px(percept, caution_std)
            card.record(percept, d.phase, choice, d.state, thresholds_px[d.phase], added_px)
        return card

    def _records(self, columns: Columns, kind: type[T]) -> list[T]:
        """The rows of a table as what they were. Raises RecordingError."""
        rows = zip(*(column.tolist() for column in columns.values()), strict=True)
        try:
            return [msgspec.convert(dict(zip(columns, row, strict=True)), kind) for row in rows]
        except msgspec.ValidationError as error:
            raise RecordingError(f"{self.path}: not a {kind.__name__}: {error}") from error

    def load_room(self, path: Path | None = None) -> Room:
        """The room in ``path``, or the shipped one that the plan names. Raises PlanError."""
        if path is None and not self.has_shipped_room:
            raise PlanError(f"{self.path}: no shipped room {self.room_name!r}; give --room")
        return load_room(path or self._shipped_room)

    @property
    def has_shipped_room(self) -> bool:
        return self._shipped_room.is_file()

    @property
    def _shipped_room(self) -> Path:
        return ROOMS / f"{self.room_name}.toml"


def _together(*tables: Columns) -> tuple[Columns, ...]:
    """The records of the same frames; a log that was cut off may miss the last of one topic."""
    count = min(len(table["stamp_ns"]) for table in tables)
    return tuple({name: column[:count] for name, column in table.items()} for table in tables)


def find_flights(folder: Path) -> list[Path]:
    """The flight logs in a folder and below, without what was recovered of one of them."""
    return sorted(
        path for path in folder.rglob("*.mcap") if not path.name.endswith(RECOVERED_SUFFIX)
    )


def find_logs(paths: Iterable[Path]) -> list[Path]:
    """The logs in these files, log folders or folders of log folders. Raises PlanError."""
    found: list[Path] = []
    for path in paths:
        logs = find_flights(path) if path.is_dir() else [path]
        if not logs:
            raise PlanError(f"{path}: no flight log (*.mcap) in this folder")
        found += logs
    return found
