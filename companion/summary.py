"""The result of a flight: summary.json and the flight's column of the paper's Table II."""

import math
from typing import Literal, Protocol

import msgspec

from companion.flying.switch import Thresholds
from companion.judging.scorecard import Account, Scorecard
from companion.judging.trust import TrustHistory
from companion.kernel.messages import Phase, TrustStatus
from companion.plan import Plan
from companion.truth import TruthAccount

Outcome = Literal["flown", "failed", "aborted"]
FLOWN_PHASES = (Phase.INITIAL, Phase.LEARNING, Phase.TEST)


class PhaseSummary(msgspec.Struct, frozen=True, kw_only=True):
    """One phase. Undefined figures (no positives, mono not ready) are null in the JSON."""

    stereo_flight_s: float
    mono_flight_s: float
    turns: int
    stereo_approaches: int
    mono_approaches: int
    overrides: int
    mse: float
    tpr: float
    fpr: float
    auc: float
    collisions: int | None
    """From motion capture; null where no truth is known, and so are the next two."""
    distance_flown_m: float | None
    cells_visited: int | None
    """Of the ground plan, CELL_M wide."""


class Summary(msgspec.Struct, frozen=True, kw_only=True):
    """A flight in figures. Those without a phase are the test phase's, as in the paper."""

    outcome: Outcome
    reason: str
    """Why it failed or was aborted, in one line; empty when flown."""
    plan: str
    room: str
    seed: int
    scheme: str
    collisions: int | None
    """Contacts seen by motion capture; null where no truth is known."""
    minimum_clearance_m: float | None
    distance_flown_m: float | None
    """Along the path that motion capture saw, take-off and landing included."""
    overrides: int
    overrides_per_min: float
    """Per minute of the test phase."""
    turns: int
    approaches: int
    stereo_approaches: int
    """Over the whole flight, by the cue that flew when each began; mono_approaches likewise."""
    mono_approaches: int
    mse: float
    tpr: float
    fpr: float
    auc: float
    threshold_px: float
    """λ above which mono reports an obstacle."""
    trust: TrustStatus
    """Of the learned estimate, at the end."""
    trusted_after_s: float
    """Flight time until it was first trusted; null where it never was."""
    trust_lost: int
    """Times that it went stale."""
    stereo_flight_s: float
    """Time with stereo in charge over the whole flight; mono_flight_s likewise."""
    mono_flight_s: float
    samples_learned: int
    frames: int
    frames_dropped: int
    camera_faults: int
    """Times that a fault of an eye, of the pair or of their timing was named."""
    sim_s: float
    """Take-off to landing, on the vehicle's clock."""
    wall_s: float
    real_time_factor: float
    phases: dict[str, PhaseSummary]


class FlightFacts(msgspec.Struct, kw_only=True):
    """What only the outside of the pipeline knows; gathered while flying."""

    outcome: Outcome = "failed"
    reason: str = ""
    frames: int = 0
    frames_dropped: int = 0
    camera_faults: int = 0
    sim_s: float = 0.0
    wall_s: float = 0.0
    collisions: int | None = None
    minimum_clearance_m: float | None = None
    distance_flown_m: float | None = None
    truth: dict[Phase, TruthAccount] = {}


class Counted(Protocol):
    """What was counted of a flight: a pipeline, or whoever counts a log anew."""

    @property
    def scorecard(self) -> Scorecard: ...

    @property
    def thresholds(self) -> Thresholds: ...

    @property
    def samples_learned(self) -> int: ...

    @property
    def trust_history(self) -> TrustHistory: ...


def summarise(plan: Plan, plan_name: str, counted: Counted, facts: FlightFacts) -> Summary:
    """The summary of a flight, finished or not."""
    accounts = counted.scorecard.accounts
    flown = [accounts[phase] for phase in FLOWN_PHASES]
    phases = {p.value: _phase_summary(accounts[p], facts.truth.get(p)) for p in FLOWN_PHASES}
    test = phases[Phase.TEST.value]
    test_min = (test.stereo_flight_s + test.mono_flight_s) / 60.0
    return Summary(
        outcome=facts.outcome,
        reason=facts.reason,
        plan=plan_name,
        room=plan.room,
        seed=plan.seed,
        scheme=plan.experiment.scheme,
        collisions=facts.collisions,
        minimum_clearance_m=facts.minimum_clearance_m,
        distance_flown_m=facts.distance_flown_m,
        overrides=test.overrides,
        overrides_per_min=test.overrides / test_min if test_min > 0 else math.nan,
        turns=test.turns,
        approaches=test.stereo_approaches + test.mono_approaches,
        stereo_approaches=sum(account.stereo_approaches for account in flown),
        mono_approaches=sum(account.mono_approaches for account in flown),
        mse=test.mse,
        tpr=test.tpr,
        fpr=test.fpr,
        auc=test.auc,
        threshold_px=counted.thresholds.mono_px,
        trust=counted.trust_history.status,
        trusted_after_s=counted.trust_history.trusted_after_s,
        trust_lost=counted.trust_history.times_lost,
        stereo_flight_s=sum(account.stereo_flight_s for account in flown),
        mono_flight_s=sum(account.mono_flight_s for account in flown),
        samples_learned=counted.samples_learned,
        frames=facts.frames,
        frames_dropped=facts.frames_dropped,
        camera_faults=facts.camera_faults,
        sim_s=facts.sim_s,
        wall_s=facts.wall_s,
        real_time_factor=facts.sim_s / facts.wall_s if facts.wall_s > 0 else math.nan,
        phases=phases,
    )


def _phase_summary(account: Account, truth: TruthAccount | None) -> PhaseSummary:
    score = account.score()
    return PhaseSummary(
        stereo_flight_s=account.stereo_flight_s,
        mono_flight_s=account.mono_flight_s,
        turns=account.turns,
        stereo_approaches=account.stereo_approaches,
        mono_approaches=account.mono_approaches,
        overrides=account.overrides,
        mse=score.mse,
        tpr=score.tpr,
        fpr=score.fpr,
        auc=score.auc,
        collisions=truth.collisions if truth else None,
        distance_flown_m=truth.distance_flown_m if truth else None,
        cells_visited=len(truth.cells) if truth else None,
    )


def table_rows(summary: Summary) -> list[tuple[str, str]]:
    """The flight's column of the paper's Table II, with what the paper's text adds to it."""
    return [
        ("Stereo flight time, m:ss", format_minutes(summary.stereo_flight_s)),
        ("Mono flight time, m:ss", format_minutes(summary.mono_flight_s)),
        ("Mean square error, px²", format_figure(summary.mse)),
        ("False positive rate", format_figure(summary.fpr)),
        ("True positive rate", format_figure(summary.tpr)),
        ("Area under the ROC curve", format_figure(summary.auc)),
        ("Stereo approaches", str(summary.stereo_approaches)),
        ("Mono approaches", str(summary.mono_approaches)),
        ("Turns (test)", str(summary.turns)),
        ("Auto-overrides (test)", str(summary.overrides)),
        ("Overrides per minute (test)", format_figure(summary.overrides_per_min)),
        ("Mono threshold λ, px", format_figure(summary.threshold_px)),
        ("Mono is trusted", _trust_text(summary)),
        (
            "Collisions (truth)",
            "unknown" if summary.collisions is None else str(summary.collisions),
        ),
    ]


def _trust_text(summary: Summary) -> str:
    """Since when, and what it is now where that is another thing."""
    if math.isnan(summary.trusted_after_s):
        return "never"
    since = f"after {format_minutes(summary.trusted_after_s)}"
    now = "" if summary.trust is TrustStatus.TRUSTED else f", now {summary.trust.value}"
    return f"{since}{now}"


def format_minutes(duration_s: float) -> str:
    """m:ss."""
    minutes, seconds = divmod(round(duration_s), 60)
    return f"{minutes}:{seconds:02d}"


def format_figure(value: float) -> str:
    """Two decimals; a dash for what is undefined."""
    return "–" if math.isnan(value) else f"{value:.2f}"
