"""Any MAVLink autopilot through MAVSDK; the only module that imports it.

MAVSDK calls back on threads of its own, which only fill slots. Degrees end here.
"""

import asyncio
import functools
import logging
import math
from collections.abc import Callable
from types import TracebackType
from typing import Self

import mavsdk.logging
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk, MavsdkConnectionError
from mavsdk.plugins.action import Action, ActionError
from mavsdk.plugins.offboard import Offboard, OffboardError, VelocityBodyYawspeed
from mavsdk.plugins.server_utility import ServerUtility, ServerUtilityError, StatusTextType
from mavsdk.plugins.telemetry import Telemetry as TelemetryPlugin
from mavsdk.plugins.telemetry import TelemetryError

from companion.kernel.attempts import attempt
from companion.kernel.clock import Clock, wall_s
from companion.kernel.errors import CompanionError, LinkError, VehicleError
from companion.kernel.messages import Event, FlightMode, Setpoint, Telemetry
from companion.kernel.settings import Settings
from companion.vehicle.deadman import Deadman, DeadmanSettings, Stage
from companion.vehicle.requests import Requests
from companion.vehicle.slots import TelemetrySlots
from companion.vehicle.states import hovers, is_disarmed, left_the_ground

logger = logging.getLogger(__name__)

POLL_PERIOD_S = 0.05
ARM_RETRY_PERIOD_S = 0.5
ASKED_TIMES = OFFBOARD_TRIES = 3
"""On bad links answers get lost, and the command for offboard may overtake the first setpoint."""
TEXT_LENGTH = 49
"""Characters that one STATUSTEXT holds; from 50 on MAVSDK sends a second one."""
ARMED_LAG_S = 2.0
"""`armed` comes with heartbeats at 1 Hz; for this long after arming, a "no" may be old."""

_GONE = {"NO_SYSTEM", "CONNECTION_ERROR", "TIMEOUT"}
_LOG_LEVELS = (logging.DEBUG, logging.DEBUG, logging.WARNING, logging.ERROR)
"""By MAVSDK's own levels; its informative lines are details of the link here."""


class MavsdkSettings(Settings, frozen=True):
    """Limits: of the link in wall time, of the verbs on the autopilot's clock."""

    heartbeat_limit_s: float = 10.0
    silence_limit_s: float = 2.0
    ready_limit_s: float = 30.0
    climb_limit_s: float = 30.0
    mode_limit_s: float = 5.0
    land_limit_s: float = 60.0
    telemetry_rate_hz: float = 30.0
    deadman: DeadmanSettings = DeadmanSettings()


class MavsdkVehicle:
    """The kernel's ``Vehicle``; a deadman watches from the first setpoint to hold or land."""

    def __init__(self, url: str, clock: Clock, settings: MavsdkSettings | None = None) -> None:
        self._url = url
        self._clock = clock
        self._settings = settings or MavsdkSettings()
        self._slots = TelemetrySlots()
        self._requests = Requests()
        self._armed_stamp_ns = -math.inf

    async def __aenter__(self) -> Self:
        _redirect_log()
        configuration = Configuration.create_with_component_type(ComponentType.COMPANION_COMPUTER)
        self._mavsdk = Mavsdk(configuration)
        try:
            await self._connect()
        except BaseException:
            await asyncio.to_thread(self._close)
            raise
        self._deadman = Deadman(
            _Emergency(self._action, self._offboard), self._clock, self._settings.deadman
        )
        self._deadman.open()
        return self

    async def __aexit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        await asyncio.to_thread(self._deadman.close)
        await asyncio.to_thread(self._close)

    def telemetry(self) -> Telemetry:
        """Raises LinkError once the link has been silent for too long."""
        self._check_link()
        return self._slots.telemetry()

    async def arm(self) -> None:
        """Tries until the autopilot is ready; it refuses while its estimator settles."""
        began_ns = self.telemetry().stamp_ns
        while True:
            try:
                await self._ask("arm", self._action.arm)
                break
            except VehicleError as error:
                if (self.telemetry().stamp_ns - began_ns) * 1e-9 > self._settings.ready_limit_s:
                    missing = self._slots.missing_for_arming or "nothing reported missing"
                    raise VehicleError(f"{error}; not ready: {missing}") from error
            await self._clock.sleep(ARM_RETRY_PERIOD_S)
        self._armed_stamp_ns = self.telemetry().stamp_ns

    async def take_off(self, height_m: float) -> None:
        await self._ask("set the take-off height", self._action.set_takeoff_altitude, height_m)
        await self.arm()
        before = self.telemetry()
        try:
            await self._ask("take off", self._action.takeoff)
        except VehicleError:
            if not left_the_ground(before, self.telemetry()):
                raise  # else only its answer got lost, and asking again was vain
        await self._confirm(
            f"hovering at {height_m:g} m",
            lambda now: hovers(now, height_m),
            self._settings.climb_limit_s,
        )

    async def start_offboard(self, setpoint: Setpoint) -> None:
        """Stands still until the autopilot confirms the mode: on a bad link that takes long."""
        still = Setpoint(stamp_ns=setpoint.stamp_ns)
        await self.send(still)
        self._deadman.rest()
        await attempt(OFFBOARD_TRIES, VehicleError, lambda: self._start_offboard(still))
        await self.send(setpoint)

    async def send(self, setpoint: Setpoint) -> None:
        """Raises VehicleError when the deadman has taken over."""
        self._check_link()
        stage = self._deadman.stage
        if stage >= Stage.HOLDING:
            raise VehicleError(f"setpoints stayed away too long: the deadman is {stage.name}")
        self._put(setpoint)

    async def say(self, event: Event) -> None:
        kind = StatusTextType.__members__.get(event.severity.upper(), StatusTextType.INFO)
        text = event.text.encode("ascii", "replace")[:TEXT_LENGTH]
        try:
            await self._ask("send a text", self._texts.send_status_text, kind, text)
        except CompanionError as error:
            logger.warning("%s", error)

    async def hold(self) -> None:
        self._check_link()
        self._stand_still()
        await self._ask("hold", self._action.hold)
        self._deadman.rest()
        await self._confirm_mode(FlightMode.HOLD)

    async def land(self) -> None:
        now = self.telemetry()
        if not now.armed and (now.stamp_ns - self._armed_stamp_ns) * 1e-9 > ARMED_LAG_S:
            return
        self._stand_still()
        await self._ask("land", self._action.land)
        self._deadman.rest()
        await self._confirm("disarmed", is_disarmed, self._settings.land_limit_s)

    def _stand_still(self) -> None:
        """What MAVSDK repeats until the autopilot has changed its mode, however late it hears."""
        if Stage.WATCHING <= self._deadman.stage <= Stage.STOPPED:
            self._put(Setpoint(stamp_ns=self._slots.telemetry().stamp_ns))

    def _close(self) -> None:
        self._requests.close()
        self._mavsdk.destroy()

    async def _start_offboard(self, setpoint: Setpoint) -> None:
        await self._ask("start offboard", self._offboard.start)
        await self._confirm_mode(FlightMode.OFFBOARD, lambda: self._put(setpoint))

    async def _connect(self) -> None:
        limit_s = self._settings.heartbeat_limit_s
        try:
            await self._mavsdk.add_any_connection(self._url)
        except MavsdkConnectionError as error:
            raise LinkError(f"{self._url}: cannot be opened: {_reason(error)}") from error
        system = await self._mavsdk.first_autopilot(limit_s)
        if system is None:
            raise LinkError(f"{self._url}: no autopilot heartbeat within {limit_s:g} s")
        self._action = Action(system._system)
        self._offboard = Offboard(system._system)
        self._plugin = TelemetryPlugin(system._system)
        self._texts = ServerUtility(system._system)
        self._slots.subscribe(self._plugin)
        rate_hz = self._settings.telemetry_rate_hz
        await self._ask("set the odometry's rate", self._plugin.set_rate_odometry, rate_hz)
        deadline_s = wall_s() + limit_s
        while not self._slots.complete:
            if wall_s() > deadline_s:
                raise LinkError(f"{self._url}: a heartbeat, but no odometry within {limit_s:g} s")
            await self._clock.sleep(POLL_PERIOD_S)

    def _check_link(self) -> None:
        silence_s = wall_s() - self._slots.heard_wall_s
        if silence_s > self._settings.silence_limit_s:
            raise LinkError(f"{self._url}: nothing from the autopilot for {silence_s:.1f} s")

    def _put(self, setpoint: Setpoint) -> None:
        try:
            turn_deg_s = math.degrees(setpoint.yaw_rate_rad_s)
            velocity = VelocityBodyYawspeed(*setpoint.velocity_hfrd_m_s, turn_deg_s)
            self._offboard.set_velocity_body(velocity)
        except OffboardError as error:
            raise LinkError(f"{self._url}: cannot send a setpoint: {_reason(error)}") from error
        self._deadman.feed()

    async def _ask(self, what: str, request: Callable[..., object], *arguments: object) -> None:
        """Raises LinkError when no answer comes however often."""
        call = functools.partial(_call, what, request, *arguments)
        await attempt(ASKED_TIMES, LinkError, lambda: self._requests.make(call))

    async def _confirm_mode(
        self, mode: FlightMode, meanwhile: Callable[[], None] | None = None
    ) -> None:
        await self._confirm(
            f"{mode.value} mode",
            lambda now: now.flight_mode is mode,
            self._settings.mode_limit_s,
            meanwhile,
        )

    async def _confirm(
        self,
        what: str,
        done: Callable[[Telemetry], bool],
        limit_s: float,
        meanwhile: Callable[[], None] | None = None,
    ) -> None:
        began_ns = self.telemetry().stamp_ns
        while not done(now := self.telemetry()):
            if (now.stamp_ns - began_ns) * 1e-9 > limit_s:
                raise VehicleError(
                    f"{what}: not confirmed within {limit_s:g} s; now {now.flight_mode.value}, "
                    f"{now.landed_state.value}, {-now.position_ned_m[2]:.2f} m above home"
                )
            if meanwhile is not None:
                meanwhile()
            await self._clock.sleep(POLL_PERIOD_S)


class _Emergency:
    """What the deadman does, from its own thread."""

    def __init__(self, action: Action, offboard: Offboard) -> None:
        self._action = action
        self._offboard = offboard

    def stop(self) -> None:
        _call("stop", self._offboard.set_velocity_body, VelocityBodyYawspeed(0.0, 0.0, 0.0, 0.0))

    def hold(self) -> None:
        _call("hold", self._action.hold)

    def land(self) -> None:
        _call("land", self._action.land)


def _call(what: str, request: Callable[..., object], *arguments: object) -> None:
    try:
        request(*arguments)
    except (ActionError, OffboardError, ServerUtilityError, TelemetryError) as error:
        if error.result.name in _GONE:
            raise LinkError(f"{what}: no answer from the autopilot ({_reason(error)})") from error
        raise VehicleError(f"{what}: refused by the autopilot ({_reason(error)})") from error


def _reason(error: Exception) -> str:
    """MAVSDK's result in plain words."""
    result = getattr(error, "result", None)
    name = str(error).rpartition(": ")[2] if result is None else result.name
    if name == "BIND_ERROR":
        return "the port is in use"
    return name.lower().replace("_", " ")


@functools.cache
def _redirect_log() -> None:
    """MAVSDK's log lines through ``logging``; once, as replacing the callback is not safe."""

    def log(level: int, message: str, _file: str | None, _line: int) -> bool:
        logger.log(_LOG_LEVELS[level], "%s", message)
        return True  # keeps the line off stdout

    mavsdk.logging.log_subscribe(log)
