"""Against wind: a velocity that nobody asked for is asked back.

An autopilot that is given velocities corrects a gust softly: at PX4's gains one of 4 m/s carries a
small vehicle by more than a metre. So the vehicle is compared with a model of how it follows its
setpoints, and what the model does not explain was done by something else (internal model control:
Morari and Zafiriou, Robust Process Control, 1989). What is too small to tell wind from an error of
the model, a second-order lag, is left alone.
"""

import math
from collections import deque
from typing import Annotated, NamedTuple

import msgspec
from msgspec import Meta

from companion.kernel.frames import hfrd_from_ned, ned_from_hfrd
from companion.kernel.messages import Event, Setpoint, Telemetry
from companion.kernel.settings import Settings
from companion.kernel.telemetry_age import TelemetryAge

Level = tuple[float, float]
"""(north, east), m/s."""

LONGEST_GAP_NS = 1_000_000_000
"""Between two frames; after a longer one the model begins anew."""
QUIET_M_S, QUIET_NS = 0.06, 1_000_000_000
"""A gust is over when the excess was smaller for so long: until then the autopilot unlearns it."""
STEP_S = 0.02


class PushBackSettings(Settings, frozen=True):
    """``[push_back]``: what is done about wind, and how the vehicle follows a level velocity."""

    gain_norm: Annotated[float, Meta(ge=0, le=1)] = 0.9
    """How much of the excess is asked back; 0 leaves gusts to the autopilot."""
    above_m_s: Annotated[float, Meta(gt=0, le=2)] = 0.2
    """The excess that counts as a gust."""
    above_norm: Annotated[float, Meta(ge=0, le=2)] = 0.6
    """At least this share of the forward speed: the model errs when the vehicle brakes."""
    most_m_s: Annotated[float, Meta(gt=0, le=2)] = 0.8
    response_delay_s: Annotated[float, Meta(ge=0, le=1)] = 0.2
    response_rad_s: Annotated[float, Meta(gt=0, le=10)] = 4.0
    response_damping: Annotated[float, Meta(gt=0, le=2)] = 0.7


class Pushed(NamedTuple):
    """A setpoint, and what a person should hear of it."""

    setpoint: Setpoint
    event: Event | None = None


class PushBack:
    """Follows what the vehicle was asked for, and compares."""

    def __init__(self, settings: PushBackSettings, forward_speed_m_s: float) -> None:
        self.settings = settings
        self.pushing = False
        self._above_m_s = max(settings.above_m_s, settings.above_norm * forward_speed_m_s)
        self._age = TelemetryAge()
        self._model = Response(settings)
        self._stamp_ns: int | None = None
        self._quiet_since_ns = 0

    def against(self, setpoint: Setpoint, telemetry: Telemetry) -> Pushed:
        """``setpoint`` with what takes away a velocity that nobody asked for.

        To be called with every frame; then ``sent`` with what became of it.
        """
        excess = self._excess(setpoint.stamp_ns, telemetry)
        if excess is None:
            self.pushing = False
            return Pushed(setpoint)
        north_m_s, east_m_s, _ = telemetry.velocity_ned_m_s
        carried = excess[0] * north_m_s + excess[1] * east_m_s > 0.0
        pushed_before, stamp_ns = self.pushing, setpoint.stamp_ns
        self.pushing = self._is_gust(stamp_ns, math.hypot(*excess), carried)
        if not self.pushing:
            return Pushed(setpoint)
        event = None if pushed_before else self._event_of(stamp_ns, excess)
        return Pushed(self._pushed(setpoint, excess, telemetry.yaw_rad), event)

    def sent(self, setpoint: Setpoint, yaw_rad: float) -> None:
        """What the autopilot got in the end."""
        forward_m_s, right_m_s, _ = setpoint.velocity_hfrd_m_s
        self._model.ask(setpoint.stamp_ns, ned_from_hfrd(forward_m_s, right_m_s, yaw_rad))

    def _is_gust(self, stamp_ns: int, excess_m_s: float, carried: bool) -> bool:
        """``carried``: it moves with the excess; one that is slower than asked may touch a wall."""
        if not self.pushing:
            self._quiet_since_ns = stamp_ns
            return carried and excess_m_s > self._above_m_s
        if excess_m_s > QUIET_M_S:
            self._quiet_since_ns = stamp_ns
        return stamp_ns - self._quiet_since_ns < QUIET_NS

    def _pushed(self, setpoint: Setpoint, excess: Level, yaw_rad: float) -> Setpoint:
        """Never faster to where it was to go anyway."""
        excess_m_s = max(math.hypot(*excess), 1e-9)
        share = -min(self.settings.gain_norm, self.settings.most_m_s / excess_m_s)
        ahead, right = hfrd_from_ned(share * excess[0], share * excess[1], yaw_rad)
        forward_m_s, right_m_s, down_m_s = setpoint.velocity_hfrd_m_s
        wanted_m_s = math.hypot(forward_m_s, right_m_s)
        if wanted_m_s > 0.0:
            way = forward_m_s / wanted_m_s, right_m_s / wanted_m_s
            more_m_s = max(0.0, ahead * way[0] + right * way[1])
            ahead, right = ahead - more_m_s * way[0], right - more_m_s * way[1]
        return msgspec.structs.replace(
            setpoint, velocity_hfrd_m_s=(forward_m_s + ahead, right_m_s + right, down_m_s)
        )

    def _event_of(self, stamp_ns: int, excess: Level) -> Event:
        bearing_deg = math.degrees(math.atan2(excess[1], excess[0])) % 360.0
        speed_m_s = math.hypot(*excess)
        done = "pushes back" if self.settings.gain_norm else "left to the autopilot"
        text = f"wind: carried off at {speed_m_s:.1f} m/s towards {bearing_deg:03.0f} deg; {done}"
        return Event(stamp_ns=stamp_ns, severity="info", text=text)

    def _excess(self, stamp_ns: int, telemetry: Telemetry) -> Level | None:
        """Of the velocity, beyond what was asked for; None where that is unknown."""
        before_ns, self._stamp_ns = self._stamp_ns, stamp_ns
        usual = self._age.is_usual(stamp_ns, telemetry.stamp_ns)
        north_m_s, east_m_s, _ = telemetry.velocity_ned_m_s
        if not (math.isfinite(north_m_s) and math.isfinite(east_m_s)):
            self._stamp_ns = None
            return None
        if before_ns is None or not 0 < stamp_ns - before_ns <= LONGEST_GAP_NS:
            self._model.restart(stamp_ns, (north_m_s, east_m_s))
            return None
        expected_north, expected_east = self._model.velocity_at(stamp_ns)
        return (north_m_s - expected_north, east_m_s - expected_east) if usual else None


class Response:
    """Level velocity that follows what was asked for as a delayed second-order lag."""

    def __init__(self, settings: PushBackSettings) -> None:
        self._delay_ns = round(settings.response_delay_s * 1e9)
        self._stiffness = settings.response_rad_s**2
        self._friction = 2.0 * settings.response_damping * settings.response_rad_s
        self._asked: deque[tuple[int, Level]] = deque()
        self.restart(0, (0.0, 0.0))

    def restart(self, stamp_ns: int, velocity_ned_m_s: Level) -> None:
        self._stamp_ns = stamp_ns
        self._velocity, self._acceleration = velocity_ned_m_s, (0.0, 0.0)
        self._asked.clear()
        self.ask(stamp_ns - self._delay_ns, velocity_ned_m_s)

    def ask(self, stamp_ns: int, velocity_ned_m_s: Level) -> None:
        self._asked.append((stamp_ns, velocity_ned_m_s))

    def velocity_at(self, stamp_ns: int) -> Level:
        """No earlier than it was asked before."""
        while self._stamp_ns < stamp_ns:
            until_ns = min(stamp_ns, self._stamp_ns + round(STEP_S * 1e9))
            self._step((until_ns - self._stamp_ns) * 1e-9)
            self._stamp_ns = until_ns
        return self._velocity

    def _step(self, passed_s: float) -> None:
        heard_ns = self._stamp_ns - self._delay_ns
        while len(self._asked) > 1 and self._asked[1][0] <= heard_ns:
            self._asked.popleft()
        (north, east), (v_north, v_east) = self._asked[0][1], self._velocity
        a_north, a_east = self._acceleration
        stiff, friction = self._stiffness, self._friction
        a_north += passed_s * (stiff * (north - v_north) - friction * a_north)
        a_east += passed_s * (stiff * (east - v_east) - friction * a_east)
        self._acceleration = a_north, a_east
        self._velocity = v_north + passed_s * a_north, v_east + passed_s * a_east
