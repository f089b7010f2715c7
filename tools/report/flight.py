"""A flight as its report tells it: log, summary, room, and the logs that lie beside."""

from bisect import bisect_right
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from companion.flightlog import Topic
from companion.flightlog.schema import nan_restorer
from companion.flying.switch import Thresholds
from companion.judging.scorecard import Scorecard
from companion.judging.trust import TrustHistory
from companion.kernel.errors import RecordingError
from companion.kernel.messages import MocapPose, Phase, TrustStatus
from companion.logfolder import LOG_NAME, SUMMARY_NAME
from companion.summary import FlightFacts, PhaseSummary, Summary, summarise
from companion.truth import TruthCounter
from tools.flown import FlownFlight

RECOUNTED = "no summary was left; counted anew from the log"


class ReportedFlight(FlownFlight):
    """``room``: its TOML file, else the shipped one of the plan's name, if any.

    Raises PlanError for a room that cannot be read.
    """

    def __init__(self, path: Path, room: Path | None = None) -> None:
        super().__init__(path)
        self.room = self.load_room(room) if room or self.has_shipped_room else None

    @property
    def trust_history(self) -> TrustHistory:
        """Of each frame; logs that are older than it say nothing."""
        history = TrustHistory()
        statuses = self.decision.get("trust", np.array([], dtype=str))
        for stamp_ns, status in zip(self.decision["stamp_ns"], statuses, strict=False):
            history.note(int(stamp_ns), TrustStatus(status))
        return history

    @cached_property
    def summary(self) -> Summary:
        """As the companion left it; of a flight that was killed, counted anew from its log."""
        path = self.path.with_name(SUMMARY_NAME)
        left = read_summary(path) if self.path.name == LOG_NAME and path.is_file() else None
        return left if left is not None and left.frames else self._recounted(left)

    def read_through(self) -> None:
        """All that a page of many flights wants, so that damage shows here."""
        _ = self.summary, self.scorecard
        if self.has_truth:
            _ = self.truth

    @property
    def logs_beside(self) -> list[Path]:
        """The vehicle's own logs of the same flight."""
        folder = self.path.parent
        return sorted(path for path in folder.iterdir() if path.suffix in (".tlog", ".ulg"))

    @property
    def _reached_the_end(self) -> bool:
        """Flew all phases; the last frame may be one period short of their length."""
        experiment = self.plan.experiment
        wanted_s = experiment.initial_s + experiment.learning_s + experiment.test_s
        return bool(self.time_s[-1] + 2.0 / self.plan.camera.rate_hz >= wanted_s)

    def _truth_counted(self) -> TruthCounter:
        """Each pose in the phase of the frame that came next, as on board."""
        counter = TruthCounter()
        if not self.has_truth:
            return counter
        frames_ns = self.decision["stamp_ns"].tolist()
        phases = [Phase(phase) for phase in self.decision["phase"].tolist()] + [Phase.DONE]
        for pose in self.log.read(Topic.MOCAP, MocapPose):
            phase = phases[bisect_right(frames_ns, pose.stamp_ns)]
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
        counted = _Counted(self.scorecard, thresholds, learned, self.trust_history)
        return summarise(self.plan, left.plan if left else self.name, counted, facts)


class _Counted(NamedTuple):
    """A log counted anew, as ``summarise`` wants it."""

    scorecard: Scorecard
    thresholds: Thresholds
    samples_learned: int
    trust_history: TrustHistory


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
