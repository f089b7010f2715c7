"""Whether the autopilot's estimate walks away, judged by the camera; and flying straight even so.

Position and velocity come from the autopilot, and so does what it makes of a setpoint: where its
velocity is wrong by some drift, a vehicle told to stand still drifts the other way. Stereo sees
that (companion.vision.odometry). What is named is taken out of the telemetry, and added to
setpoints.
"""

import math
import statistics
from collections import deque
from collections.abc import Sequence
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from companion.kernel.frames import hfrd_from_ned
from companion.kernel.messages import Drift, Event, Setpoint, Telemetry
from companion.kernel.settings import Settings
from companion.vision.lens import Floats
from companion.vision.odometry import Motion

Speed = Annotated[float, Meta(gt=0, le=2)]

WINDOW_NS, LEAST_MEASUREMENTS = 3_000_000_000, 8
MOST_SCATTER_M_S = 0.06
"""Median deviation from the median; beyond, camera and telemetry are out of step, not astray."""
CONFIRMED_NS = 600_000_000
"""So long nothing may speak against a drift above the limit by less than the scatter."""
RECORD_PERIOD_NS = 1_000_000_000
SLOW_M_S, FAST_M_S = 0.25, 0.3
"""Below the one, stereo's scale hardly matters; above the other, it shows."""
LEAST_RATIOS, MOST_RATIOS = 30, 300
RENEWED_EVERY = 10


class DriftSettings(Settings, frozen=True):
    """``[drift]``: when the autopilot's level velocity counts as wrong."""

    correct: bool = True
    """Fly on the corrected estimate; else it is named only."""
    name_above_m_s: Speed = 0.13
    clear_below_m_s: Speed = 0.06

    def __post_init__(self) -> None:
        if self.clear_below_m_s >= self.name_above_m_s:
            raise ValueError(
                f"clear_below_m_s must be below name_above_m_s, got {self.clear_below_m_s}"
            )


class Judgement(NamedTuple):
    """What is to be told: an event where the verdict changed, a record where it was time."""

    event: Event | None = None
    record: Drift | None = None


class _Scale:
    """By what share the camera's speed falls short of the autopilot's in flight ahead.

    Focal length and baseline may be nominal, and that is no drift: it grows with the speed, and
    turns with the vehicle.
    """

    def __init__(self) -> None:
        self._ratios: deque[float] = deque(maxlen=MOST_RATIOS)
        self._n_learned = 0
        self._share = math.nan

    def learn(self, told: Floats, excess: Floats) -> None:
        """Both (2,), level."""
        if math.hypot(*told) > FAST_M_S:
            self._ratios.append(float(excess @ told / (told @ told)))
            self._n_learned += 1
            if self._n_learned >= LEAST_RATIOS and self._n_learned % RENEWED_EVERY == 0:
                self._share = statistics.median(self._ratios)

    def without(self, told: Floats, excess: Floats) -> Floats | None:
        """``excess`` without the scale's share; None where that is unknown and matters."""
        if math.isnan(self._share):
            return excess if math.hypot(*told) < SLOW_M_S else None
        return excess - self._share * told


class DriftMonitor:
    """Keeps the last verdict where the camera cannot see how it moves."""

    def __init__(self, settings: DriftSettings) -> None:
        self.settings = settings
        self.named = False
        self.n_named = 0
        """How often it was found to drift."""
        self._scale = _Scale()
        self._measured: deque[tuple[int, float, float]] = deque()
        self._drift_ned_m_s = (0.0, 0.0)
        self._scatter_m_s = 0.0
        self._walked_ned_m = (0.0, 0.0)
        """Of the position's error, what was seen while it was named."""
        self._walked_to_ns: int | None = None
        self._recorded_ns: int | None = None
        self._above_since_ns: int | None = None

    def corrected(self, telemetry: Telemetry, stamp_ns: int) -> Telemetry:
        """Position and velocity without the drift; untouched before any was found."""
        self._walk(stamp_ns)
        if not self.n_named or not self.settings.correct:
            return telemetry
        (north, east), (v_north, v_east) = self._walked_ned_m, self._taken_out()
        n, e, d = telemetry.position_ned_m
        v_n, v_e, v_d = telemetry.velocity_ned_m_s
        return msgspec.structs.replace(
            telemetry,
            position_ned_m=(n - north, e - east, d),
            velocity_ned_m_s=(v_n - v_north, v_e - v_east, v_d),
        )

    def compensated(self, setpoint: Setpoint, yaw_rad: float) -> Setpoint:
        """What the autopilot must be asked for, so that the vehicle does as ``setpoint`` says."""
        if not self.named or not self.settings.correct:
            return setpoint
        ahead, right = hfrd_from_ned(*self._drift_ned_m_s, yaw_rad)
        forward_m_s, right_m_s, down_m_s = setpoint.velocity_hfrd_m_s
        return msgspec.structs.replace(
            setpoint, velocity_hfrd_m_s=(forward_m_s + ahead, right_m_s + right, down_m_s)
        )

    def judge(self, stamp_ns: int, motion: Motion | None) -> Judgement:
        """``motion``: by the autopilot and by the camera, None where nothing was measured."""
        told_anew = motion is not None and self._measure(stamp_ns, motion)
        event = self._name(stamp_ns)
        return Judgement(event, self._record(stamp_ns) if told_anew else None)

    def _measure(self, stamp_ns: int, motion: Motion) -> bool:
        """Whether enough is known, and agrees, to tell the drift anew."""
        excess = self._excess(motion)
        if excess is None:
            return False
        self._measured.append((stamp_ns, float(excess[0]), float(excess[1])))
        while stamp_ns - self._measured[0][0] > WINDOW_NS:
            self._measured.popleft()
        _, north, east = zip(*self._measured, strict=True)
        drift = statistics.median(north), statistics.median(east)
        scatter_m_s = max(_scatter(north, drift[0]), _scatter(east, drift[1]))
        if len(self._measured) < LEAST_MEASUREMENTS or scatter_m_s > MOST_SCATTER_M_S:
            self._above_since_ns = None
            return False
        self._drift_ned_m_s, self._scatter_m_s = drift, scatter_m_s
        return True

    def _excess(self, motion: Motion) -> Floats | None:
        """Of the autopilot's level velocity, (2,); what is known to drift teaches no scale."""
        told = motion.told_ned_m_s[:2]
        excess = told - motion.seen_ned_m_s[:2]
        drift = np.array(self._taken_out())
        self._scale.learn(told - drift, excess - drift)
        return self._scale.without(told - drift, excess)

    def _walk(self, stamp_ns: int) -> None:
        """Adds up how far the position went astray since the last frame."""
        before_ns, self._walked_to_ns = self._walked_to_ns, stamp_ns
        if before_ns is None or not self.named:
            return
        passed_s = max(0.0, (stamp_ns - before_ns) * 1e-9)
        (north, east), (v_north, v_east) = self._walked_ned_m, self._drift_ned_m_s
        self._walked_ned_m = north + v_north * passed_s, east + v_east * passed_s

    def _taken_out(self) -> tuple[float, float]:
        return self._drift_ned_m_s if self.named else (0.0, 0.0)

    def _name(self, stamp_ns: int) -> Event | None:
        """An event where it begins or ends to drift."""
        speed_m_s = math.hypot(*self._drift_ned_m_s)
        if self.named:
            if speed_m_s > self.settings.clear_below_m_s:
                return None
            self.named = False
            text = "estimator: velocity agrees with the camera again"
            return Event(stamp_ns=stamp_ns, severity="info", text=text)
        if not self._is_sure(stamp_ns, speed_m_s):
            return None
        self.named = True
        self.n_named += 1
        north, east = self._drift_ned_m_s
        bearing_deg = math.degrees(math.atan2(east, north)) % 360.0
        done = "corrected" if self.settings.correct else "not corrected"
        text = f"estimator: drifts by {speed_m_s:.2f} m/s towards {bearing_deg:03.0f} deg; {done}"
        return Event(stamp_ns=stamp_ns, severity="warning", text=text)

    def _is_sure(self, stamp_ns: int, speed_m_s: float) -> bool:
        """Above the limit by more than the scatter, or for long enough."""
        above_m_s = speed_m_s - self.settings.name_above_m_s
        if above_m_s <= 0.0:
            self._above_since_ns = None
            return False
        if self._above_since_ns is None:
            self._above_since_ns = stamp_ns
        return above_m_s > self._scatter_m_s or stamp_ns - self._above_since_ns >= CONFIRMED_NS

    def _record(self, stamp_ns: int) -> Drift | None:
        if self._recorded_ns is not None and stamp_ns - self._recorded_ns < RECORD_PERIOD_NS:
            return None
        self._recorded_ns = stamp_ns
        return Drift(
            stamp_ns=stamp_ns,
            velocity_ned_m_s=self._drift_ned_m_s,
            scatter_m_s=self._scatter_m_s,
            measurements=len(self._measured),
            named=self.named,
            walked_ned_m=self._walked_ned_m,
        )


def _scatter(values: Sequence[float], middle: float) -> float:
    """Median deviation."""
    return statistics.median(abs(value - middle) for value in values)
