"""How far two logs' clocks are apart: where a signal that both have fits best."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate

from companion.flightlog import Topic
from companion.kernel.errors import RecordingError
from tools.logs.series import LogReader, Table

Floats = NDArray[np.float64]

GRID_HZ = 50.0
LEAST_OVERLAP_S = 10.0
LEAST_SHARE = 0.5
"""Of the shorter log; a few turns look alike in any two flights."""
LEAST_CORRELATION = 0.7
"""Two different flights of the same plan stay below it; the same flight reaches 0.9 and more."""

SIGNALS: dict[str, tuple[tuple[str, str], ...]] = {
    "yaw rate": (
        (Topic.TELEMETRY, "yaw_rate_rad_s"),
        ("ATTITUDE", "yawspeed"),
        ("vehicle_angular_velocity", "xyz[2]"),
        ("vehicle_attitude", "yawspeed"),
        ("vehicle_odometry", "angular_velocity[2]"),
    ),
    "height": (
        (Topic.TELEMETRY, "position_ned_m[2]"),
        ("LOCAL_POSITION_NED", "z"),
        ("vehicle_local_position", "z"),
    ),
}
"""Signals that any log of a flight has under one of these (series, column) names."""


class Alignment(NamedTuple):
    """``time in ours = time in theirs + offset_s``."""

    offset_s: float
    signal: str
    correlation: float
    """Of the signal in both logs, once aligned; 1 is a perfect fit."""


class Signal(NamedTuple):
    """Samples of one quantity; ``time_s`` ascends strictly, both of shape (n,)."""

    time_s: Floats
    value: Floats


def align(ours: LogReader, theirs: LogReader) -> Alignment:
    """Raises RecordingError where the logs share no signal, or not the same flight."""
    found = []
    for name, places in SIGNALS.items():
        one, other = _signal(ours, places), _signal(theirs, places)
        if one is not None and other is not None:
            found.append(best_fit(name, one, other))
    if not found:
        raise RecordingError(f"{theirs.path}: neither yaw rate nor height in both logs to align by")
    best = max(found, key=lambda fit: fit.correlation)
    if not best.correlation >= LEAST_CORRELATION:
        raise RecordingError(
            f"{theirs.path}: shows another flight than {ours.path}: "
            f"{best.signal} correlates {best.correlation:.2f} at best"
        )
    return best._replace(offset_s=best.offset_s + stamp_delay_s(ours) - stamp_delay_s(theirs))


def signals(ours: LogReader, theirs: LogReader, fit: Alignment) -> tuple[Signal, Signal]:
    """What aligned the two logs, both on the time line of ours."""
    one, other = (_signal(log, SIGNALS[fit.signal]) for log in (ours, theirs))
    assert one is not None, "it was aligned by this signal"
    assert other is not None, "it was aligned by this signal"
    moved_s = fit.offset_s + stamp_delay_s(theirs)
    return (
        one._replace(time_s=one.time_s + stamp_delay_s(ours)),
        other._replace(time_s=other.time_s + moved_s),
    )


def stamp_delay_s(log: LogReader) -> float:
    """From the autopilot's clock, which stamps telemetry, to the log's own time line.

    The median over the flight: telemetry is logged with the frame it was used for, some time
    after it was measured.
    """
    if Topic.TELEMETRY not in log.records():
        return 0.0
    table = log.table(Topic.TELEMETRY)
    return float(np.median(table.time_s - table.columns["stamp_ns"] * 1e-9))


def best_fit(name: str, ours: Signal, theirs: Signal) -> Alignment:
    """The offset of greatest normalised cross-correlation, to a fraction of the grid's step."""
    a, b = _on_grid(ours), _on_grid(theirs)
    score = _correlation(a, b)
    peak = int(np.argmax(score))
    lag = peak - (len(b) - 1) + _vertex(score, peak)
    offset_s = ours.time_s[0] - theirs.time_s[0] + lag / GRID_HZ
    return Alignment(float(offset_s), name, float(score[peak]))


def _signal(log: LogReader, places: Sequence[tuple[str, str]]) -> Signal | None:
    """The first of the places that the log has, with enough of it to compare."""
    records = log.records()
    for series, column in places:
        if series not in records:
            continue
        table = log.table(series)
        value = _column(table, column)
        if value is not None:
            stamps_ns = table.columns["stamp_ns"] if series == Topic.TELEMETRY else None
            time_s = table.time_s if stamps_ns is None else stamps_ns * 1e-9
            return _clean(time_s, value)
    return None


def _column(table: Table, name: str) -> Floats | None:
    if name in table.columns:
        return np.asarray(table.columns[name], dtype=np.float64)
    stem, _, index = name.rstrip("]").partition("[")
    if index and stem in table.columns and table.columns[stem].ndim == 2:
        return np.asarray(table.columns[stem][:, int(index)], dtype=np.float64)
    return None


def _clean(time_s: Floats, value: Floats) -> Signal | None:
    known = np.isfinite(value)
    time_s, first = np.unique(time_s[known], return_index=True)
    if len(time_s) < 2 or time_s[-1] - time_s[0] < LEAST_OVERLAP_S:
        return None
    return Signal(time_s, value[known][first])


def _on_grid(signal: Signal) -> Floats:
    count = int((signal.time_s[-1] - signal.time_s[0]) * GRID_HZ) + 1
    grid_s = signal.time_s[0] + np.arange(count) / GRID_HZ
    value = np.interp(grid_s, signal.time_s, signal.value)
    return np.asarray(value - value.mean())


def _correlation(a: Floats, b: Floats) -> Floats:
    """At each lag, over what overlaps there; 0 where that is too short or too still to tell."""
    energy_a = correlate(a**2, np.ones(len(b)), method="fft")
    energy_b = correlate(np.ones(len(a)), b**2, method="fft")
    overlap = np.rint(correlate(np.ones(len(a)), np.ones(len(b)), method="fft"))
    moving = 0.1 * min(np.sum(a**2), np.sum(b**2))
    least = max(LEAST_OVERLAP_S * GRID_HZ, LEAST_SHARE * min(len(a), len(b)))
    usable = (overlap >= least) & (np.minimum(energy_a, energy_b) > moving)
    score = np.zeros(len(overlap))
    product = correlate(a, b, method="fft")
    score[usable] = product[usable] / np.sqrt(energy_a[usable] * energy_b[usable])
    return score


def _vertex(score: Floats, peak: int) -> float:
    """Where between the grid's points the parabola through the peak is highest: -0.5..0.5."""
    if not 0 < peak < len(score) - 1:
        return 0.0
    before, top, after = score[peak - 1 : peak + 2]
    bend = before - 2.0 * top + after
    return float(0.5 * (before - after) / bend) if bend < 0 else 0.0
