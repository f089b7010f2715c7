"""A flight as its report tells it: log, summary, room, and the logs that lie beside."""

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from companion.flight import LOG_NAME, SUMMARY_NAME
from companion.flightlog import FlightLog, Topic
from companion.flightlog.schema import nan_restorer
from companion.kernel.errors import RecordingError
from companion.kernel.messages import Cue, Decision, MocapPose, Percept, Phase
from companion.kernel.settings import convert_settings
from companion.plan import Plan
from companion.scorecard import Scorecard
from companion.summary import FlightFacts, PhaseSummary, Summary, summarise
from companion.switch import Choice, Thresholds
from companion.truth import TruthCounter
from sitl.arena.room import Room, load_room
from tools.logs.recover import RECOVERED_SUFFIX

ROOMS = Path(__file__).parents[2] / "flightplans" / "rooms"
RECOUNTED = "no summary was left; counted anew from the log"

Columns = dict[str, NDArray[Any]]
T = TypeVar("T", bound=msgspec.Struct)


class ReportedFlight:
    """One flight; ``room``: its TOML file, else the shipped one of the plan's name, if any.

    Raises RecordingError for what is no flight log, or one in which nothing was flown.
    """

    def __init__(self, path: Path, room: Path | None = None) -> None:
        self.path = path
        self.log = FlightLog(path)
        if not {Topic.DECISION, Topic.PERCEPT} <= set(self.log.topics()):
            raise RecordingError(f"{path}: nothing was flown")
        self.plan = convert_settings(dict(self.log.metadata.plan), Plan, f"{path}: plan")
        self.room = self._load_room(room)

    @property
    def name(self) -> str:
        """The log folder's name, which says when, what and with which seed."""
        return self.path.resolve().parent.name if self.path.name == LOG_NAME else self.path.stem

    @cached_property
    def decision(self) -> Columns:
        return self._whole_frames[0]

    @cached_property
    def percept(self) -> Columns:
        return self._whole_frames[1]

    @cached_property
    def time_s(self) -> NDArray[np.float64]:
        """(n_frames,) since the first frame."""
        stamp_ns = self.percept["stamp_ns"]
        return np.asarray((stamp_ns - stamp_ns[0]) * 1e-9, dtype=np.float64)

    @cached_property
    def places_m(self) -> NDArray[np.float64]:
        """(n_frames, 2): north and east; the truth where it is known, else the estimate."""
        if self.mocap:
            stamps_ns, truth_m = self.mocap["stamp_ns"], self.mocap["truth_position_ned_m"]
        else:
            telemetry_m = self.log.columns(Topic.TELEMETRY)["position_ned_m"]
            stamps_ns, truth_m = self.log.log_times_ns(Topic.TELEMETRY), telemetry_m
        at_ns = self.percept["stamp_ns"]
        return np.stack([np.interp(at_ns, stamps_ns, truth_m[:, axis]) for axis in (0, 1)], axis=1)

    @cached_property
    def mocap(self) -> Columns:
        """Empty for a log without truth."""
        return self.log.columns(Topic.MOCAP) if Topic.MOCAP in self.log.topics() else {}

    @cached_property
    def summary(self) -> Summary:
        """As the companion left it; of a flight that was killed, counted anew from its log."""
        path = self.path.with_name(SUMMARY_NAME)
        left = read_summary(path) if self.path.name == LOG_NAME and path.is_file() else None
        return left if left is not None and left.frames else self._recounted(left)

    @property
    def logs_beside(self) -> list[Path]:
        """The vehicle's own logs of the same flight."""
        folder = self.path.parent
        return sorted(path for path in folder.iterdir() if path.suffix in (".tlog", ".ulg"))

    @cached_property
    def scorecard(self) -> Scorecard:
        """The flight's own counts, made anew from its records."""
        card = Scorecard(self.plan.behaviour.turn_threshold_px)
        records = zip(_rows(self.percept, Percept), _rows(self.decision, Decision), strict=True)
        for percept, d in records:
            choice = Choice(d.cue, d.override, d.disparity_px, d.threshold_px, None)
            card.record(percept, d.phase, choice, d.state, self.mono_threshold_px(d.phase))
        return card

    def mono_threshold_px(self, phase: str) -> float:
        """Above which mono turned in this phase; the plan's fixed one where mono never flew."""
        return self._mono_thresholds_px.get(phase, self._fixed_threshold_px)

    @cached_property
    def _mono_thresholds_px(self) -> dict[str, float]:
        decision = self.decision
        mono = decision["cue"] == Cue.MONO
        phases, thresholds_px = decision["phase"][mono], decision["threshold_px"][mono]
        return dict(zip(phases.tolist(), thresholds_px.tolist(), strict=True))

    @property
    def _reached_the_end(self) -> bool:
        """Flew all phases; the last frame may be one period short of their length."""
        experiment = self.plan.experiment
        wanted_s = experiment.initial_s + experiment.learning_s + experiment.test_s
        return bool(self.time_s[-1] + 2.0 / self.plan.camera.rate_hz >= wanted_s)

    @property
    def _fixed_threshold_px(self) -> float:
        return self.plan.learner.fixed_threshold_px(self.plan.behaviour.turn_threshold_px)

    @cached_property
    def _whole_frames(self) -> tuple[Columns, Columns]:
        """The decisions and percepts of the same frames."""
        tables = (self.log.columns(Topic.DECISION), self.log.columns(Topic.PERCEPT))
        count = min(len(table["stamp_ns"]) for table in tables)
        one, other = ({name: c[:count] for name, c in table.items()} for table in tables)
        return one, other

    def _load_room(self, path: Path | None) -> Room | None:
        if path is not None:
            return load_room(path)
        shipped = ROOMS / f"{Path(self.plan.room).stem}.toml"
        return load_room(shipped) if shipped.is_file() else None

    def _truth_counted(self) -> TruthCounter:
        """Each pose in the phase of the frame that came next, as on board."""
        counter = TruthCounter()
        if not self.mocap:
            return counter
        phases = [Phase(phase) for phase in self.decision["phase"].tolist()] + [Phase.DONE]
        next_frame = np.searchsorted(self.decision["stamp_ns"], self.mocap["stamp_ns"], "right")
        for pose, frame in zip(self.log.read(Topic.MOCAP, MocapPose), next_frame, strict=True):
            phase = phases[frame]
            if phase is Phase.DONE:
                counter.begin_landing()
            counter.count(pose, phase)
        return counter

    def _recounted(self, left: Summary | None) -> Summary:
        facts = FlightFacts(
            outcome=left.outcome if left else "flown" if self._reached_the_end else "failed",
            reason=f"{left.reason}; counted anew from the log" if left else RECOUNTED,
            frames=len(self.time_s),
            sim_s=float(self.time_s[-1]),
        )
        truth = self._truth_counted()
        facts.collisions = truth.collisions
        facts.minimum_clearance_m = truth.minimum_clearance_m
        facts.distance_flown_m = truth.distance_flown_m
        facts.truth = truth.accounts
        mono_px = self.mono_threshold_px(self.decision["phase"][-1])
        thresholds = Thresholds(
            self.plan.behaviour.turn_threshold_px,
            mono_px,
            self.plan.behaviour.override_threshold_px,
        )
        learned = left.samples_learned if left else 0
        counted = _Counted(self.scorecard, thresholds, learned)
        return summarise(self.plan, left.plan if left else self.name, counted, facts)


def _rows(columns: Columns, kind: type[T]) -> Iterator[T]:
    """The records that a table was made of."""
    for values in zip(*(column.tolist() for column in columns.values()), strict=True):
        yield msgspec.convert(dict(zip(columns, values, strict=True)), kind)


class _Counted(NamedTuple):
    """A log counted anew, as ``summarise`` wants it."""

    scorecard: Scorecard
    thresholds: Thresholds
    samples_learned: int


class Override(NamedTuple):
    """Stereo took the control: when, where and why."""

    phase: str
    time_s: float
    duration_s: float
    place_m: tuple[float, float]
    """North, east."""
    stereo_px: float
    mono_px: float
    mono_threshold_px: float


def overrides(flight: ReportedFlight) -> list[Override]:
    """Those that count: one per approach, as the flight itself counted them."""
    decision, percept = flight.decision, flight.percept
    active = decision["override"].astype(bool)
    found = []
    for index in np.flatnonzero(active & ~np.append(False, active[:-1])):
        clear = np.flatnonzero(~active[index:])
        end = index + int(clear[0]) if len(clear) else len(active) - 1
        first_of_phase = index == 0 or decision["phase"][index] != decision["phase"][index - 1]
        counted_before = 0 if first_of_phase else decision["overrides"][index - 1]
        if decision["overrides"][index] > counted_before:
            phase = str(decision["phase"][index])
            found.append(
                Override(
                    phase=phase,
                    time_s=float(flight.time_s[index]),
                    duration_s=float(flight.time_s[end] - flight.time_s[index]),
                    place_m=(float(flight.places_m[index, 0]), float(flight.places_m[index, 1])),
                    stereo_px=float(percept["stereo_px"][index]),
                    mono_px=float(percept["mono_px"][index]),
                    mono_threshold_px=flight.mono_threshold_px(phase),
                )
            )
    return found


def read_summary(path: Path) -> Summary | None:
    """None for what another version of the companion left. Raises RecordingError."""
    try:
        table = msgspec.json.decode(path.read_bytes(), type=dict[str, Any])
        phases = {
            name: nan_restorer(PhaseSummary)(phase) for name, phase in table["phases"].items()
        }
        return msgspec.convert(nan_restorer(Summary)(table | {"phases": phases}), Summary)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error
    except msgspec.ValidationError:
        return None
    except (msgspec.DecodeError, KeyError, AttributeError) as error:
        raise RecordingError(f"{path}: not the summary of a flight: {error}") from error


def find_flights(folder: Path) -> list[Path]:
    """The flight logs in a folder and below, without what was recovered of one of them."""
    return sorted(
        path for path in folder.rglob("*.mcap") if not path.name.endswith(RECOVERED_SUFFIX)
    )
