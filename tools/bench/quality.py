"""How well the vehicle flies, against the truth: hovering, steps, wind; in simulated time."""

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.kernel.errors import CompanionError
from companion.kernel.frames import Vector3, wrap_angle_rad
from companion.kernel.messages import FlightMode
from sitl.arena.contact import RoomContact
from sitl.arena.room import RoomSettings, build_room
from sitl.autopilot.interface import OffboardSetpoint
from sitl.faults import Faults
from sitl.injection import inject
from sitl.settings import EstimatorSettings, SitlSettings
from sitl.simulator import World
from tools.bench.harness import Row

SEED = 1
HALL_M = (40.0, 40.0, 10.0)
SAMPLE_S = 0.02
HEIGHT_M = 1.2
HOVER_S = 60.0
STEP_S = 6.0
SPEED_M_S = 0.5
SPEED_TOLERANCE_M_S = 0.03
YAW_RATE_RAD_S = math.radians(45.0)
WIND_M_S = 5.0
BESIDE = "with an exact estimate"
BAND_NORM = 0.1
"""A step has settled when it stays this near: the estimate's noise is half of that."""

EXACT = EstimatorSettings(
    velocity_bias_m_s=0.0,
    velocity_noise_m_s=0.0,
    height_error_m=0.0,
    attitude_error_deg=0.0,
    yaw_error_deg=0.0,
    gyro_noise_rad_s=0.0,
    accelerometer_noise_m_s2=0.0,
)
"""What is left of an error with it is the controller's."""

Series = NDArray[np.float64]


class StepResponse(NamedTuple):
    """Of a step from 0 to 1: 10 to 90 %, beyond 1, and until it stays within BAND_NORM."""

    rise_s: float
    overshoot_percent: float
    settling_s: float


class Trial:
    """One vehicle hovering in a hall."""

    def __init__(
        self, estimator: EstimatorSettings | None = None, wind_ned_m_s: Vector3 | None = None
    ) -> None:
        room = build_room(RoomSettings(size_m=HALL_M), Path("hall"))
        settings = SitlSettings(estimator=estimator or EstimatorSettings())
        self.world = World(room, settings, SEED, RoomContact(room))
        autopilot = self.autopilot = self.world.autopilot
        self._until(lambda: autopilot.status.ready_to_arm)
        autopilot.arm()
        autopilot.take_off(HEIGHT_M)
        self._until(lambda: autopilot.status.mode is FlightMode.HOLD)
        self.world.advance_to(self.world.time_s + 5.0)
        if wind_ned_m_s is not None:
            inject(self.world, Faults(wind_ned_m_s=wind_ned_m_s))

    def hover(self) -> Series:
        """True distance from where it begins to hold, for HOVER_S, of shape (n,)."""
        start_m = self.world.truth.position_ned_m
        places_m = (self.world.truth.position_ned_m for _ in self._samples(HOVER_S))
        return np.array([math.dist(place_m, start_m) for place_m in places_m])

    def fly_north(self, duration_s: float, speed_m_s: float) -> tuple[Series, Series]:
        """Speed north, of shape (n,): in truth, and as the reference wants it."""
        setpoint = OffboardSetpoint(velocity_ned_m_s=(speed_m_s, 0.0, 0.0))
        truth, wanted = [], []
        for _ in self._samples(duration_s, setpoint):
            truth.append(self.world.truth.velocity_ned_m_s[0])
            wanted.append(self.autopilot.status.velocity_setpoint_ned_m_s[0])
        return np.array(truth), np.array(wanted)

    def turn(self, duration_s: float, yaw_rate_rad_s: float) -> tuple[Series, Series]:
        """Yaw rate, of shape (n,): in truth, and as the reference wants it."""
        still: Vector3 = (0.0, 0.0, 0.0)
        setpoint = OffboardSetpoint(velocity_ned_m_s=still, yaw_rate_rad_s=yaw_rate_rad_s)
        truth, wanted = [], []
        before_rad = self.world.truth.euler_rad[2]
        for _ in self._samples(duration_s, setpoint):
            now_rad = self.world.truth.euler_rad[2]
            truth.append(wrap_angle_rad(now_rad - before_rad) / SAMPLE_S)
            wanted.append(self.autopilot.status.yaw_rate_setpoint_rad_s)
            before_rad = now_rad
        return np.array(truth), np.array(wanted)

    def _samples(
        self, duration_s: float, setpoint: OffboardSetpoint | None = None
    ) -> Iterator[None]:
        for _ in range(round(duration_s / SAMPLE_S)):
            if setpoint is not None:
                self.autopilot.set_offboard_setpoint(setpoint)
                if self.autopilot.status.mode is not FlightMode.OFFBOARD:
                    self.autopilot.set_mode(FlightMode.OFFBOARD)
            self.world.advance_to(self.world.time_s + SAMPLE_S)
            yield

    def _until(self, done: Callable[[], bool], limit_s: float = 30.0) -> None:
        end_s = self.world.time_s + limit_s
        while not done():
            if self.world.time_s > end_s:
                raise CompanionError("bench: the vehicle does not get into the air")
            self.world.step()


def rows() -> Iterator[Row]:
    yield from _hovering()
    yield from _speed()
    yield from _turning()
    yield from _wind()


def step_response(series: Series) -> StepResponse:
    """``series``: a step to 1 that begins before the first sample, every SAMPLE_S."""
    if series.max() < 1.0 - BAND_NORM:
        raise CompanionError(f"bench: a step reached {series.max():.0%} of what was commanded")
    first = [int(np.argmax(series >= level)) for level in (0.1, 0.9)]
    outside = np.flatnonzero(np.abs(series - 1.0) > BAND_NORM)
    return StepResponse(
        (first[1] - first[0]) * SAMPLE_S,
        100.0 * max(0.0, float(series.max()) - 1.0),
        (int(outside[-1]) + 1 if len(outside) else 0) * SAMPLE_S,
    )


def _rms(series: Series) -> float:
    return float(np.sqrt(np.mean(series**2)))


def _hovering() -> Iterator[Row]:
    beside = (BESIDE, _rms(Trial(EXACT).hover()))
    yield Row.of(f"hover for {HOVER_S:g} s: error, RMS", _rms(Trial().hover()), "m", beside)


def _speed() -> Iterator[Row]:
    truth, wanted = (series / SPEED_M_S for series in Trial().fly_north(STEP_S, SPEED_M_S))
    yield from _step_rows(f"{SPEED_M_S:g} m/s", truth, wanted)
    steady, _ = Trial().fly_north(4 * STEP_S, SPEED_M_S)
    error_m_s = abs(float(steady[len(steady) // 4 :].mean()) - SPEED_M_S)
    yield Row.of(
        f"{SPEED_M_S:g} m/s commanded: error of the mean speed",
        error_m_s,
        "m/s",
        ("the estimate's own bias, deviation", SitlSettings().estimator.velocity_bias_m_s),
        goal=SPEED_TOLERANCE_M_S,
    )


def _turning() -> Iterator[Row]:
    truth, wanted = (series / YAW_RATE_RAD_S for series in Trial().turn(STEP_S, YAW_RATE_RAD_S))
    yield from _step_rows(f"{math.degrees(YAW_RATE_RAD_S):g} deg/s", truth, wanted)


def _step_rows(name: str, truth: Series, wanted: Series) -> Iterator[Row]:
    ours, reference = step_response(truth), step_response(wanted)
    words: Sequence[tuple[str, str]] = (("rise", "s"), ("overshoot", "%"), ("settling", "s"))
    for (what, unit), value, beside in zip(words, ours, reference, strict=True):
        yield Row.of(f"step to {name}: {what}", value, unit, ("its reference", beside))


def _wind() -> Iterator[Row]:
    """Begins at once, as when a door opens; the second half is taken as settled."""
    wind_ned_m_s = (0.0, WIND_M_S, 0.0)
    ours_m, exact_m = (Trial(estimator, wind_ned_m_s).hover() for estimator in (None, EXACT))
    figures: dict[str, Callable[[Series], float]] = {
        f"{WIND_M_S:g} m/s wind begins: carried off, at most": lambda m: float(m.max()),
        f"{WIND_M_S:g} m/s wind: error after 30 s, RMS": lambda m: _rms(m[len(m) // 2 :]),
    }
    for what, figure in figures.items():
        yield Row.of(what, figure(ours_m), "m", (BESIDE, figure(exact_m)))
