"""The way of a frame: perceive, learn, decide, command. No I/O, no clock, no tasks."""

import math
from typing import NamedTuple

import numpy as np

from companion.behaviour import Behaviour
from companion.cells import CellMap, freer_side
from companion.kernel.calibration import StereoCalibration
from companion.kernel.messages import (
    Cue,
    Decision,
    Goal,
    MonoMap,
    Percept,
    Phase,
    StereoFrame,
    Telemetry,
)
from companion.learner import Learner
from companion.performance import threshold_for_tpr_px
from companion.pilot import fly_to
from companion.plan import Plan
from companion.risk import Approach, Wishes, choose_threshold_px
from companion.safety import Verdict, check
from companion.scorecard import Account, Scorecard
from companion.stereo import StereoMatcher
from companion.switch import Choice, Switch, Thresholds
from companion.textons import TextonDictionary

PHASES_OF_LEARNING = (Phase.INITIAL, Phase.LEARNING)


class Step(NamedTuple):
    """All that one frame led to."""

    percept: Percept
    decision: Decision
    verdict: Verdict
    mono_map: MonoMap | None = None
    """Where the learner makes maps, and has learned to."""


class Pipeline:
    """The flight's whole state between two frames; the same for all vehicles and clocks."""

    def __init__(
        self,
        plan: Plan,
        calibration: StereoCalibration,
        dictionary: TextonDictionary | None = None,
    ) -> None:
        rngs = np.random.default_rng(plan.seed).spawn(4)
        switch_rng, behaviour_rng, learner_rng, self._risk_rng = rngs
        self.plan = plan
        self.matcher = StereoMatcher(plan.stereo, calibration, label=plan.learner.label)
        self.learner = Learner(plan.learner, learner_rng, dictionary)
        self.switch = Switch(plan.experiment, switch_rng)
        self.behaviour = Behaviour(plan.behaviour, behaviour_rng)
        self.scorecard = Scorecard(plan.behaviour.turn_threshold_px)
        self.phase = Phase.INITIAL
        self.samples_learned = 0
        self.flown_s = 0.0
        """Of the plan, at the newest frame; what a resumed flight begins with may be set here."""
        self.thresholds = self._choose_thresholds()
        self._began_ns: int | None = None

    def step(self, frame: StereoFrame, telemetry: Telemetry) -> Step:
        """One frame on. Raises CameraError for a frame of the wrong size."""
        self._enter_phase_at(frame.stamp_ns)
        percept, mono_map_px = self._perceive_and_learn(frame)
        choice = self.switch.choose(
            percept, self.phase, self.thresholds, self.behaviour.looks_ahead
        )
        freer_sign = self._freer_sign(choice.cue, mono_map_px)
        goal = self.behaviour.step(frame.stamp_ns, choice.blocked, telemetry.yaw_rad, freer_sign)
        account = self.scorecard.record(
            percept, self.phase, choice, self.behaviour.state, self.thresholds.mono_px
        )
        decision = self._decision(frame.stamp_ns, choice, account)
        verdict = self._command(frame.stamp_ns, goal, telemetry)
        return Step(percept, decision, verdict, _map_message(frame.stamp_ns, mono_map_px))

    def _enter_phase_at(self, stamp_ns: int) -> None:
        if self._began_ns is None:
            self._began_ns = stamp_ns - round(self.flown_s * 1e9)
        self.flown_s = (stamp_ns - self._began_ns) * 1e-9
        phase = self.plan.experiment.phase_at(self.flown_s)
        if phase is not self.phase:
            self.thresholds = self._choose_thresholds()
            if phase in (Phase.TEST, Phase.DONE):
                self.learner.freeze()
            self.phase = phase

    def _perceive_and_learn(self, frame: StereoFrame) -> tuple[Percept, CellMap | None]:
        """Predicts first, then learns from the frame: estimates stay prequential."""
        stereo = self.matcher.match(frame.left, frame.right)
        features = self.learner.observe(self.learner.image_of(frame))
        mono = self.learner.predict(features)
        self.samples_learned += self.learner.learn(
            features, stereo.disparity_px, self.matcher.last_map
        )
        percept = Percept(
            stamp_ns=frame.stamp_ns,
            stereo_px=stereo.disparity_px,
            stereo_valid_norm=stereo.valid_norm,
            mono_px=mono.mono_px,
            mono_std_px=mono.std_px,
            mono_novelty=mono.novelty,
        )
        return percept, mono.map_px

    def _freer_sign(self, cue: Cue, mono_map_px: CellMap | None) -> int:
        """The side that is freer in the eyes of the cue that flies; 0 where nobody asks."""
        if self.plan.behaviour.turn_to == "random":
            return 0
        map_px = self.matcher.last_map() if cue is Cue.STEREO else mono_map_px
        return 0 if map_px is None else freer_side(map_px)

    def _command(self, stamp_ns: int, goal: Goal, telemetry: Telemetry) -> Verdict:
        behaviour = self.plan.behaviour
        setpoint = fly_to(
            goal,
            telemetry,
            stamp_ns=stamp_ns,
            height_m=behaviour.height_m,
            yaw_rate_limit_rad_s=math.radians(behaviour.yaw_rate_deg_s),
            settings=self.plan.pilot,
        )
        return check(setpoint, telemetry, self.plan.safety)

    def _decision(self, stamp_ns: int, choice: Choice, account: Account) -> Decision:
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
        )

    def _choose_thresholds(self) -> Thresholds:
        """Mono's comes from the samples of all learning so far, where the plan says so.

        While those hold no positive it is the fixed one.
        """
        behaviour, learner = self.plan.behaviour, self.plan.learner
        stereo_px = behaviour.turn_threshold_px
        chosen_px = math.nan
        if learner.threshold == "roc":
            chosen_px = self._threshold_from_roc_px(stereo_px, learner.wanted_tpr)
        elif learner.threshold == "risk":
            chosen_px = self._threshold_from_risk_px(stereo_px)
        mono_px = learner.fixed_threshold_px(stereo_px) if math.isnan(chosen_px) else chosen_px
        return Thresholds(stereo_px, mono_px, behaviour.override_threshold_px)

    def _threshold_from_roc_px(self, positive_px: float, wanted_tpr: float) -> float:
        """NaN while no positive was seen."""
        seen = [self.scorecard.accounts[phase].estimates() for phase in PHASES_OF_LEARNING]
        stereo_px, mono_px = (np.concatenate(values) for values in zip(*seen, strict=True))
        return threshold_for_tpr_px(mono_px, stereo_px, positive_px, wanted_tpr)

    def _threshold_from_risk_px(self, positive_px: float) -> float:
        """NaN while no positive was seen."""
        learner = self.plan.learner
        wishes = Wishes(
            learner.wanted_collision_probability,
            learner.wanted_spurious_turns_per_m,
            learner.detection_distance_m,
        )
        approach = approach_of(self.plan, self.matcher.calibration)
        samples = self.scorecard.approach_samples(PHASES_OF_LEARNING)
        return choose_threshold_px(samples, approach, wishes, self._risk_rng)


def _map_message(stamp_ns: int, map_px: CellMap | None) -> MonoMap | None:
    if map_px is None:
        return None
    cells_px = tuple(map_px.reshape(-1).tolist())
    return MonoMap(stamp_ns=stamp_ns, columns=map_px.shape[1], disparity_px=cells_px)


def approach_of(plan: Plan, calibration: StereoCalibration) -> Approach:
    """The approach that the performance model (companion/risk.py) reckons with."""
    return Approach(
        rate_hz=plan.camera.rate_hz,
        speed_m_s=plan.behaviour.forward_speed_m_s,
        disparity_metre_px=calibration.disparity_metre_px,
        positive_threshold_px=plan.behaviour.turn_threshold_px,
    )
