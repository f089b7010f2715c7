"""The matrix: every fault with the outcome that is expected of it, stated before it is flown."""

import itertools
from collections.abc import Mapping
from enum import StrEnum
from typing import Literal, NamedTuple

BEFORE_FLIGHT_S = 10.0
"""The world's time at which a flight's first phase begins, about: take-off takes as long."""
PHASES_S = {"initial": 14.0, "learning": 16.0, "test": 24.0}
MOMENTS_S = {"initial": 8.0, "learning": 20.0, "test": 36.0, "trusted": 66.0}
"""Since the first phase began."""
TRUSTED_INITIAL_S = 44.0
"""Long enough for stereo to come to an obstacle, without which nothing is trusted."""
ROOMS = ("room1", "office", "corridor")
PLAN_WORDS = (
    *(f"experiment.{phase}_s={duration_s}" for phase, duration_s in PHASES_S.items()),
    "log.model_period_s=5",
    "sitl.parameters.COM_OBL_RC_ACT=4",
)
"""Without setpoints the autopilot lands, as the README asks for."""

Deed = Literal["", "full disk", "spoilt model", "spoilt newest model", "kill and restart"]


class Outcome(StrEnum):
    FLIES = "keeps flying"
    HOLDS = "holds"
    LANDS = "lands"
    REFUSES = "refuses to start"
    CRASHES = "crashes"
    FLIES_AWAY = "flies away"


class Case(NamedTuple):
    """One fault. Steps are (seconds after the moment, keys of sitl.faults.Faults)."""

    name: str
    expected: Outcome
    steps: tuple[tuple[float, Mapping[str, object]], ...] = ()
    deed: Deed = ""
    """What is done to the companion, rather than to the vehicle."""
    moments: tuple[str, ...] = tuple(PHASES_S)
    words: tuple[str, ...] = ()
    """Keys of the plan, KEY=VALUE."""


def _lasting(**faults: object) -> tuple[tuple[float, Mapping[str, object]], ...]:
    return ((0.0, faults),)


def _passing(
    duration_s: float, begin: Mapping[str, object], end: Mapping[str, object]
) -> tuple[tuple[float, Mapping[str, object]], ...]:
    return ((0.0, begin), (duration_s, end))


_EYES = ("left", "right")
_EYE_FAULTS = (
    "no_frames", "frozen", "black", "saturated", "half", "torn", "defocused", "dirty",
)  # fmt: skip
_MISMATCHES = ("swapped", "decalibrated", "desynchronised")
_TRUSTING = (
    *(f"experiment.initial_s={TRUSTED_INITIAL_S}", "learner.preset=best"),
    *("learner.threshold_ratio=1", "learner.caution_std=1"),
    *("trust.least_approaches=1", "trust.confirm_s=0"),
    *("trust.auc=0", "trust.collision_probability=1", "trust.error_norm=100"),
    *("trust.recent_error_norm=100", "trust.novelty=100"),
)
"""So that a minute of learning is trusted as ten minutes would be."""


def _blind_of(what: str, faults: Mapping[str, object]) -> tuple[Case, Case]:
    """Stereo goes: before the learner can be trusted, and after."""
    steps = _lasting(**faults)
    return (
        Case(f"{what}, nothing learned", Outcome.LANDS, steps, moments=("initial",)),
        Case(f"{what}, learned", Outcome.FLIES, steps, moments=("trusted",), words=_TRUSTING),
    )


_CUT, _CLEAR = {"link_loss_norm": 1.0}, {"link_loss_norm": 0.0}
_ONCE = ("test",)
"""For what happens before the flight, the moment makes no difference."""

CASES = (
    Case("none", Outcome.FLIES, moments=_ONCE),
    *(
        case
        for eye, fault in itertools.product(_EYES, _EYE_FAULTS)
        for case in _blind_of(f"{eye} eye {fault}", {f"{eye}_eye": fault})
    ),
    *(case for fault in _MISMATCHES for case in _blind_of(f"eyes {fault}", {"stereo_pair": fault})),
    Case("both eyes black", Outcome.LANDS, _lasting(left_eye="black", right_eye="black")),
    Case("camera silent", Outcome.LANDS, _lasting(stereo_pair="no_frames")),
    Case("camera frozen", Outcome.LANDS, _lasting(stereo_pair="frozen")),
    Case("frames 0.3 s late", Outcome.FLIES, _lasting(stereo_pair="late")),
    Case("link lost for 1 s", Outcome.FLIES, _passing(1.0, _CUT, _CLEAR)),
    Case("link lost for 5 s", Outcome.LANDS, _passing(5.0, _CUT, _CLEAR)),
    Case("link lost for good", Outcome.LANDS, _lasting(**_CUT)),
    Case("30 % of the packets lost", Outcome.FLIES, _lasting(link_loss_norm=0.3)),
    Case("300 ms latency", Outcome.FLIES, _lasting(link_latency_s=0.3)),
    Case(
        "estimator drifts by 0.2 m/s", Outcome.FLIES, _lasting(estimator_drift_ned_m_s=(0.2, 0, 0))
    ),
    Case(
        "gust of 4 m/s for 2 s",
        Outcome.FLIES,
        _passing(2.0, {"wind_ned_m_s": (4.0, 0, 0)}, {"wind_ned_m_s": (0.0, 0, 0)}),
    ),
    Case("one motor at 80 %", Outcome.FLIES, _lasting(motor_efficiency_norm=(0.8, 1.0, 1.0, 1.0))),
    Case("battery at 8 %", Outcome.LANDS, _lasting(charge_norm=0.08)),
    Case("disk full", Outcome.LANDS, deed="full disk", moments=_ONCE),
    Case("model spoilt at start", Outcome.REFUSES, deed="spoilt model", moments=_ONCE),
    Case(
        "newest model spoilt, the one before whole",
        Outcome.FLIES,
        deed="spoilt newest model",
        moments=_ONCE,
    ),
)
MAVLINK_ONLY = (
    Case(
        "companion killed and started again",
        Outcome.FLIES,
        deed="kill and restart",
        words=("sitl.parameters.COM_OBL_RC_ACT=5",),
    ),
)
"""In lockstep the vehicle would die with its companion."""


def events_of(case: Case, moment: str) -> list[dict[str, object]]:
    """The plan's ``sitl.events``."""
    at_s = BEFORE_FLIGHT_S + MOMENTS_S[moment]
    return [{"at_s": at_s + after_s, **faults} for after_s, faults in case.steps]
