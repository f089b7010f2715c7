"""The way of a frame: perceive, learn, decide, command. No I/O, no clock, no tasks."""

import math
from typing import NamedTuple

import numpy as np

from companion.flying.behaviour import Behaviour
from companion.flying.certainty import certainty_norm, with_speed_for
from companion.flying.pilot import fly_to
from companion.flying.push_back import PushBack, Pushed
from companion.flying.safety import Reaction, Verdict, check, react_to_age
from companion.flying.switch import Choice, Switch, Thresholds, caution_px
from companion.flying.tether import way_back_rad
from companion.health import CameraHealth
from companion.judging.drift import DriftMonitor
from companion.judging.scorecard import Account, Scorecard
from companion.judging.trust import TrustHistory, TrustMonitor, event_of
from companion.kernel.calibration import StereoCalibration
from companion.kernel.messages import (
    Availability,
    Cue,
    Decision,
    Drift,
    Event,
    Goal,
    Health,
    MonoMap,
    Percept,
    Phase,
    Setpoint,
    StereoFrame,
    Telemetry,
    TrustFigures,
    TrustStatus,
)
from companion.learning.learner import Learner
from companion.perception import Perception
from companion.plan import Plan
from companion.thresholds import approach_of, choose_thresholds
from companion.vision.cells import CellMap, freer_side
from companion.vision.odometry import Odometry
from companion.vision.stereo import StereoMatcher
from companion.vision.textons import TextonDictionary


class Step(NamedTuple):
    """All that one frame led to."""

    percept: Percept
    decision: Decision
    verdict: Verdict
    mono_map: MonoMap | None = None
    """Where the learner makes maps, and has learned to."""
    trust: TrustFigures | None = None
    """Where it was time to judge."""
    health: Health | None = None
    """Where it has changed."""
    drift: Drift | None = None
    """Where it was time to say how well the autopilot's velocity agrees with the camera's."""
    events: tuple[Event, ...] = ()
    """What a person should hear of."""


class Pipeline:
    """The flight's whole state between two frames; the same for all vehicles and clocks."""

    def __init__(
        self,
        plan: Plan,
        calibration: StereoCalibration,
        dictionary: TextonDictionary | None = None,
    ) -> None:
        rngs = np.random.default_rng(plan.seed).spawn(5)
        switch_rng, behaviour_rng, learner_rng, self._risk_rng, trust_rng = rngs
        self.plan = plan
        self.matcher = StereoMatcher(plan.stereo, calibration, label=plan.learner.label)
        self.learner = Learner(plan.learner, learner_rng, dictionary)
        self.switch = Switch(plan.experiment, switch_rng)
        self.behaviour = Behaviour(plan.behaviour, behaviour_rng)
        self.scorecard = Scorecard(plan.behaviour.turn_threshold_px)
        self.trust = TrustMonitor(
            plan.trust,
            approach_of(plan, calibration),
            plan.learner.detection_distance_m,
            trust_rng,
        )
        self.health = CameraHealth(plan.health, plan.safety.stop_after_s)
        self.perception = Perception(self.matcher, self.learner, self.health)
        self.drift = DriftMonitor(plan.drift)
        self._push_back = PushBack(plan.push_back, plan.behaviour.forward_speed_m_s)
        ahead_m, right_m, down_m = plan.camera.mount_frd_m
        left_eye_m = ahead_m, right_m - calibration.baseline_m / 2.0, down_m
        size_px = calibration.width_px, calibration.height_px
        self._odometry = Odometry(
            self.matcher.lens, size_px, self.matcher.disparity_metre_px, left_eye_m
        )
        self.trust_history = TrustHistory()
        self.phase = Phase.INITIAL
        self.flown_s = 0.0
        """Of the plan, at the newest frame; what a resumed flight begins with may be set here."""
        self.thresholds = self._choose_thresholds()
        self._began_ns: int | None = None
        self._sighted_ns = 0
        """The newest frame that some cue could fly on."""

    def step(self, frame: StereoFrame, telemetry: Telemetry, arrived_s: float = math.nan) -> Step:
        """One frame on. Raises CameraError for a frame of the wrong size.

        ``arrived_s``: when the frame came, on any clock; NaN where nobody knows.
        """
        elapsed_s = self._elapsed_s(frame.stamp_ns)
        self._enter_phase_at(elapsed_s)
        raw, telemetry = telemetry, self.drift.corrected(telemetry, frame.stamp_ns)
        seen = self.perception.see(frame, telemetry, arrived_s)
        outlook = self.health.conclude(seen.percept, self.trust.status is TrustStatus.TRUSTED)
        available = outlook.available
        if self.plan.experiment.stereo_is_over(elapsed_s):
            available = available._replace(stereo=False)
        percept, mono_map_px = self.perception.settle(seen, available.stereo), seen.map_px
        thresholds = self._thresholds_now
        choice = self.switch.choose(
            percept,
            self.phase,
            thresholds,
            self.behaviour.looks_ahead,
            available,
            self.trust.status,
        )
        certainty = certainty_norm(choice, percept)
        freer_sign = self._freer_sign(choice, mono_map_px)
        goal = self._goal(frame.stamp_ns, choice, certainty, freer_sign, telemetry)
        added_px = caution_px(percept, thresholds.caution_std)
        account = self.scorecard.record(
            percept, self.phase, choice, self.behaviour.state, thresholds.mono_px, added_px
        )
        decision = self._decision(frame.stamp_ns, choice, certainty, account)
        verdict, pushed = self._command(frame.stamp_ns, choice, goal, telemetry)
        mono_map = _map_message(frame.stamp_ns, mono_map_px)
        judged, events = self._judge(percept, available, added_px)
        drift, drift_events = self._judge_drift(percept, available, raw)
        events = outlook.events + events + drift_events + pushed
        return Step(percept, decision, verdict, mono_map, judged, outlook.record, drift, events)

    @property
    def samples_learned(self) -> int:
        return self.perception.samples_learned

    def _judge(
        self, percept: Percept, available: Availability, added_px: float
    ) -> tuple[TrustFigures | None, tuple[Event, ...]]:
        """Whether mono may be trusted from the next frame on; a change is an event.

        ``added_px``: by caution, to mono's λ.
        """
        before = self.trust.status
        self.trust_history.note(percept.stamp_ns, before)
        judged = self.trust.update(
            percept,
            self.behaviour.state,
            self.thresholds.mono_px,
            available.stereo,
            added_px,
        )
        figures = self.trust.figures
        changed = figures.status is not before
        return figures if judged else None, (event_of(figures),) if changed else ()

    def _judge_drift(
        self, percept: Percept, available: Availability, telemetry: Telemetry
    ) -> tuple[Drift | None, tuple[Event, ...]]:
        """By the pairs that stereo could be flown on; ``telemetry``: as the autopilot sent it."""
        if not available.stereo or math.isnan(percept.stereo_px):
            return None, ()
        matches, stamp_ns = self.matcher.last_matches(), percept.stamp_ns
        event, record = self.drift.judge(
            stamp_ns, self._odometry.observe(matches, stamp_ns, telemetry)
        )
        return record, () if event is None else (event,)

    def _elapsed_s(self, stamp_ns: int) -> float:
        """Since the first frame."""
        if self._began_ns is None:
            self._began_ns = stamp_ns - round(self.flown_s * 1e9)
            self._sighted_ns = stamp_ns
        self.flown_s = (stamp_ns - self._began_ns) * 1e-9
        return self.flown_s

    def _enter_phase_at(self, elapsed_s: float) -> None:
        experiment = self.plan.experiment
        phase = experiment.phase_at(elapsed_s, self.trust.status)
        if phase is not self.phase:
            self.thresholds = self._choose_thresholds()
            if phase in (Phase.TEST, Phase.DONE) and experiment.scheme != "auto":
                self.learner.freeze()
            self.phase = phase

    def _freer_sign(self, choice: Choice, mono_map_px: CellMap | None) -> int:
        """The side that is freer in the eyes of the cue that flies; 0 where nobody asks."""
        if self.plan.behaviour.turn_to == "random" or choice.blocked is None:
            return 0
        map_px = self.matcher.last_map() if choice.cue is Cue.STEREO else mono_map_px
        return 0 if map_px is None else freer_side(map_px)

    def _goal(
        self,
        stamp_ns: int,
        choice: Choice,
        certainty: float,
        freer_sign: int,
        telemetry: Telemetry,
    ) -> Goal:
        """The behaviour's, no faster than certainty allows; without a cue it stands still."""
        settings = self.plan.behaviour
        if choice.cue is Cue.NONE:
            return Goal(forward_speed_m_s=0.0, heading_rad=telemetry.yaw_rad, turn_sign=0)
        north_m, east_m, _ = telemetry.position_ned_m
        back_rad = way_back_rad(settings.zone, self._elapsed_s(stamp_ns), north_m, east_m)
        goal = self.behaviour.step(
            stamp_ns, choice.blocked, telemetry.yaw_rad, freer_sign, back_rad
        )
        careful = settings.speed_by_certainty or not self.health.available.stereo
        return with_speed_for(goal, certainty, settings) if careful else goal

    def _command(
        self, stamp_ns: int, choice: Choice, goal: Goal, telemetry: Telemetry
    ) -> tuple[Verdict, tuple[Event, ...]]:
        """The safe setpoint; holds and lands where no cue could be relied on for too long."""
        behaviour = self.plan.behaviour
        setpoint = fly_to(
            goal,
            telemetry,
            stamp_ns=stamp_ns,
            height_m=behaviour.height_m,
            yaw_rate_limit_rad_s=math.radians(behaviour.yaw_rate_deg_s),
            settings=self.plan.pilot,
        )
        pushed = self._push_back.against(setpoint, telemetry)
        if choice.cue is Cue.NONE:
            pushed = Pushed(setpoint)
        else:
            self._sighted_ns = stamp_ns
        setpoint = self.drift.compensated(pushed.setpoint, telemetry.yaw_rad)
        verdict = check(setpoint, telemetry, self.plan.safety)
        flies = verdict.reaction is Reaction.FLY
        flown = pushed.setpoint if flies else Setpoint(stamp_ns=stamp_ns)
        self._push_back.sent(flown, telemetry.yaw_rad)
        reaction = react_to_age((stamp_ns - self._sighted_ns) * 1e-9, self.plan.safety)
        if reaction > verdict.reaction:
            verdict = verdict._replace(reaction=reaction, reason=self._why_blind())
        return verdict, () if pushed.event is None else (pushed.event,)

    def _why_blind(self) -> str:
        faults = f" ({self.health.faults})" if self.health.faults else ""
        return f"stereo is gone{faults}, and the estimate of one eye is {self.trust.status.value}"

    def _decision(
        self, stamp_ns: int, choice: Choice, certainty: float, account: Account
    ) -> Decision:
        return Decision(
            stamp_ns=stamp_ns,
            phase=self.phase,
            cue=choice.cue,
            override=choice.override,
            disparity_px=choice.disparity_px,
            threshold_px=choice.threshold_px,
            state=self.behaviour.state,
            overrides=account.overrides,
            turns=account.turns,
            approaches=account.approaches,
            trust=self.trust.status,
            certainty_norm=certainty,
        )

    @property
    def _thresholds_now(self) -> Thresholds:
        """Without the caution where that leaves no way at all."""
        thresholds = self.thresholds
        stuck = self.behaviour.searched_in_vain
        return thresholds._replace(caution_std=0.0) if stuck else thresholds

    def _choose_thresholds(self) -> Thresholds:
        approach = approach_of(self.plan, self.matcher.calibration)
        return choose_thresholds(self.plan, approach, self.scorecard, self._risk_rng)


def _map_message(stamp_ns: int, map_px: CellMap | None) -> MonoMap | None:
    if map_px is None:
        return None
    cells_px = tuple(map_px.reshape(-1).tolist())
    return MonoMap(stamp_ns=stamp_ns, columns=map_px.shape[1], disparity_px=cells_px)
