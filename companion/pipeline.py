"""The way of a frame: perceive, learn, decide, command. No I/O, no clock, no tasks."""

import math
from typing import NamedTuple

import numpy as np

from companion.behaviour import Behaviour
from companion.kernel.calibration import StereoCalibration
from companion.kernel.messages import Decision, Goal, Percept, Phase, StereoFrame, Telemetry
from companion.learner import Learner
from companion.performance import threshold_for_tpr_px
from companion.pilot import fly_to
from companion.plan import Plan
from companion.safety import Verdict, check
from companion.scorecard import Account, Scorecard
from companion.stereo import StereoMatcher
from companion.switch import Choice, Switch, Thresholds


class Step(NamedTuple):
    """All that one frame led to."""

    percept: Percept
    decision: Decision
    verdict: Verdict


class Pipeline:
    """The flight's whole state between two frames; the same for all vehicles and clocks."""

    def __init__(self, plan: Plan, calibration: StereoCalibration) -> None:
        switch_rng, behaviour_rng, learner_rng = np.random.default_rng(plan.seed).spawn(3)
        self.plan = plan
        self.matcher = StereoMatcher(plan.stereo, calibration, label=plan.learner.label)
        self.learner = Learner(plan.learner, learner_rng)
        self.switch = Switch(plan.experiment, switch_rng)
        self.behaviour = Behaviour(plan.behaviour, behaviour_rng)
        self.scorecard = Scorecard(plan.behaviour.turn_threshold_px)
        self.phase = Phase.INITIAL
        self.thresholds = self._initial_thresholds()
        self._began_ns: int | None = None

    def step(self, frame: StereoFrame, telemetry: Telemetry) -> Step:
        """One frame on. Raises CameraError for a frame of the wrong size."""
        self._enter_phase_at(frame.stamp_ns)
        percept = self._perceive_and_learn(frame)
        choice = self.switch.choose(
            percept, self.phase, self.thresholds, self.behaviour.looks_ahead
        )
        goal = self.behaviour.step(frame.stamp_ns, choice.blocked, telemetry.yaw_rad)
        account = self.scorecard.record(
            percept, self.phase, choice, self.behaviour.state, self.thresholds.mono_px
        )
        decision = self._decision(frame.stamp_ns, choice, account)
        return Step(percept, decision, self._command(frame.stamp_ns, goal, telemetry))

    def _enter_phase_at(self, stamp_ns: int) -> None:
        if self._began_ns is None:
            self._began_ns = stamp_ns
        elapsed_s = (stamp_ns - self._began_ns) * 1e-9
        phase = self.plan.experiment.phase_at(elapsed_s)
        if phase is not self.phase:
            self.thresholds = self._choose_thresholds()
            if phase in (Phase.TEST, Phase.DONE):
                self.learner.freeze()
            self.phase = phase

    def _perceive_and_learn(self, frame: StereoFrame) -> Percept:
        """Predicts first, then learns from the frame: estimates stay prequential."""
        stereo = self.matcher.match(frame.left, frame.right)
        eye = frame.left if self.plan.learner.eye == "left" else frame.right
        features = self.learner.observe(eye)
        mono_px, mono_std_px = math.nan, math.nan
        if features is not None:
            mono_px, mono_std_px = self.learner.predict(features)
            self.learner.learn(features, stereo.disparity_px)
        return Percept(
            stamp_ns=frame.stamp_ns,
            stereo_px=stereo.disparity_px,
            stereo_valid_norm=stereo.valid_norm,
            mono_px=mono_px,
            mono_std_px=mono_std_px,
        )

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

    def _initial_thresholds(self) -> Thresholds:
        behaviour, learner = self.plan.behaviour, self.plan.learner
        mono_px = learner.threshold_px
        if mono_px is None:
            mono_px = learner.threshold_ratio * behaviour.turn_threshold_px
        return Thresholds(behaviour.turn_threshold_px, mono_px, behaviour.override_threshold_px)

    def _choose_thresholds(self) -> Thresholds:
        """From the ROC of all learning so far where the plan says so and positives exist."""
        fixed = self._initial_thresholds()
        if self.plan.learner.threshold != "roc":
            return fixed
        seen = [self.scorecard.accounts[p].estimates() for p in (Phase.INITIAL, Phase.LEARNING)]
        stereo_px = np.concatenate([stereo for stereo, _ in seen])
        mono_px = np.concatenate([mono for _, mono in seen])
        chosen_px = threshold_for_tpr_px(
            mono_px, stereo_px, fixed.stereo_px, self.plan.learner.wanted_tpr
        )
        return fixed if math.isnan(chosen_px) else fixed._replace(mono_px=chosen_px)
