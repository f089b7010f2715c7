"""The world: a room, an airframe in it, an autopilot on it; time moves only by ``step``."""

import logging
import math
from collections import deque
from typing import Final, Protocol

import numpy as np

from companion.kernel.errors import PlanError
from companion.kernel.frames import Vector3, quaternion_from_euler
from companion.kernel.messages import LandedState, MocapPose
from sitl.airframe import Airframe, AirframeState
from sitl.autopilot.autopilot import CONTROL_HZ, Autopilot
from sitl.camera_faults import CameraFaults
from sitl.conditions import CLEAR, LinkConditions, link_rng
from sitl.environment.surroundings import Surroundings
from sitl.faults import check, check_parameters
from sitl.hull import (
    CRASH_SPEED_M_S,
    HULL_RADIUS_M,
    ContactCounter,
    Surfaces,
    approach_speed_m_s,
    push_ned_n,
)
from sitl.injection import inject
from sitl.sensors.nature import floor_along_m, surface_along_m
from sitl.settings import SitlSettings

_log = logging.getLogger(__name__)

GUST_STREAM: Final = 4
"""Keys of random numbers among those spawned from the seed; the autopilot's is 0, others are taken
by ``sitl.build`` and ``sitl.conditions``."""
CAMERA_FAULTS_STREAM: Final = 5
MOCAP_HZ: Final = 100
_MOCAP_KEPT: Final = 600 * MOCAP_HZ  # poses that wait for a reader; then the oldest go

# Contact is looked for at every step of the physics when the hull is closer to the room than this,
# or the feet to the floor in a fall.
_NEAR_M: Final = 0.15
_FAR_M: Final = 1000.0  # what no range finder sees
_FLOOR: Final[Vector3] = (0.0, 0.0, -1.0)
_LEVEL: Final = 0.9  # cosine of the steepest top that one can land on
_FLOOR_CONTACT_M: Final = 0.002  # height of the feet; a loaded foot gives way by as much


class StartingPlace(Protocol):
    """What the world itself needs of a room."""

    @property
    def start_position_ned_m(self) -> Vector3: ...

    @property
    def start_yaw_rad(self) -> float: ...


class World:
    """Everything that happens, deterministic in ``seed`` and in what is commanded when.

    Positions of ``truth`` and ``mocap`` are in room coordinates: NED from the centre of the floor.
    The autopilot's home is where the vehicle stands at the start.
    """

    def __init__(
        self, room: StartingPlace, settings: SitlSettings, seed: int, surfaces: Surfaces
    ) -> None:
        self.physics_hz = settings.physics_hz
        self._control_every = self.whole_steps(CONTROL_HZ, "control rate")
        self._mocap_every = self.whole_steps(MOCAP_HZ, "motion capture rate")
        self._surfaces = surfaces
        self.airframe = Airframe(settings.airframe, settings.physics_hz, room.start_yaw_rad)
        north_m, east_m, floor_m = room.start_position_ned_m
        self.room_from_home_m: Vector3 = (north_m, east_m, floor_m - self.airframe.rest_height_m)
        self._ticks = self._read_ticks = 0
        self._state = self.airframe.read()
        self._captured_m = self._in_room(self._state.position_ned_m)
        self.autopilot = Autopilot(
            self._state,
            self.airframe.hover_thrust_norm,
            lambda: self.time_s,
            np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0,))),
            settings.estimator,
            settings.battery,
        )
        self.autopilot.sensors.floor_amsl_m = settings.home.amsl_m
        self.autopilot.sensors.way_m = self._way_m
        self.surroundings = Surroundings(
            self.airframe,
            self.autopilot,
            settings,
            np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(GUST_STREAM,))),
        )
        self.camera_faults = CameraFaults(
            np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(CAMERA_FAULTS_STREAM,)))
        )
        self._events = deque(sorted(settings.events, key=lambda event: event.at_s))
        self.link = LinkConditions(CLEAR, link_rng(seed))
        """Of the companion's link, whatever carries it."""
        self.mocap: deque[MocapPose] = deque(maxlen=_MOCAP_KEPT)
        self._walls, self._floor = ContactCounter(), ContactCounter()
        self.landing_contacts = 0
        """Of the collisions, those while landing: no eye looks down."""
        self._pushed = self._near = False
        self._landed = True
        """When its motors turned last."""
        self.clearance_m = self._clearance()[0]
        self.minimum_clearance_m = math.inf
        """Smallest distance between hull and room in flight so far."""
        self.distance_flown_m = 0.0
        self.crashed: str | None = None
        """Why the flight ended in a crash, or None."""
        self.fell = False
        """The crash was a fall after landing: a hull that hangs on an edge slides off it."""
        if self.clearance_m <= 0.0:
            raise PlanError(
                f"start.position_m: the hull reaches {-self.clearance_m:.2f} m into a wall; keep "
                f"{HULL_RADIUS_M} m away from walls and furniture"
            )
        self._begin(settings)

    def _begin(self, settings: SitlSettings) -> None:
        """What the plan wants from the start; what it wants later is checked now."""
        check_parameters(settings.parameters, "sitl.")
        check(settings.faults, "sitl.faults.")
        for number, event in enumerate(settings.events):
            check(event, f"sitl.events[{number}].")
        for name, value in settings.parameters.items():
            self.autopilot.set_parameter(name, value)
        inject(self, settings.faults)

    def whole_steps(self, rate_hz: float, what: str) -> int:
        """Steps of the physics in a period of ``rate_hz``. Raises PlanError unless it is whole."""
        exact = self.physics_hz / rate_hz if rate_hz > 0.0 else 0.0
        steps = round(exact)
        if steps >= 1 and abs(exact - steps) < 1e-6 * steps:
            return steps
        slower, faster = max(1, math.ceil(exact)), max(1, math.floor(exact))
        raise PlanError(
            f"{what} {rate_hz:g} Hz: its period must be a whole number of physics steps of "
            f"1/{self.physics_hz} s; nearest: {self.physics_hz / slower:.6g} Hz or "
            f"{self.physics_hz / faster:.6g} Hz"
        )

    @property
    def time_s(self) -> float:
        return self._ticks / self.physics_hz

    @property
    def stamp_ns(self) -> int:
        return self._ticks * 1_000_000_000 // self.physics_hz

    @property
    def truth(self) -> AirframeState:
        """The vehicle's motion now, in room coordinates."""
        state = self._read()
        return state._replace(position_ned_m=self._in_room(state.position_ned_m))

    @property
    def collisions(self) -> int:
        """Contacts in flight with walls, ceiling, furniture, and with the floor unless landing."""
        return self._walls.count + self._floor.count

    def advance_to(self, time_s: float) -> None:
        """Steps until ``time_s``; times between two steps are rounded to the nearest."""
        target = round(time_s * self.physics_hz)
        while self._ticks < target:
            self.step()

    def step(self) -> None:
        """One step of the physics, and what is due before it."""
        ticks = self._ticks
        if ticks % self._control_every == 0:
            self._control()
        capture = ticks % self._mocap_every == 0
        if capture or self._near:
            self._touch()
        if capture:
            self._capture()
        self.airframe.step()
        self._ticks = ticks + 1

    def _control(self) -> None:
        while self._events and self._events[0].at_s <= self.time_s:
            inject(self, self._events.popleft())
        state = self._read()
        self.surroundings.update(state)
        command = self.autopilot.update(state)
        if command.spinning:
            self._landed = not self.autopilot.airborne
        self.airframe.spin(command.spinning)
        self.airframe.command(*command.attitude)

    def _read(self) -> AirframeState:
        """The state of this tick, in coordinates of home; read at most once."""
        if self._read_ticks != self._ticks:
            self._state = self.airframe.read()
            self._read_ticks = self._ticks
        return self._state

    def _touch(self) -> None:
        """Pushes the hull out of what it has run into, and counts contacts in flight."""
        state = self._read()
        self.clearance_m, normal = self._clearance()
        feet_m = -state.position_ned_m[2] - _FLOOR_CONTACT_M
        falling = state.velocity_ned_m_s[2] > CRASH_SPEED_M_S
        self._near = self.clearance_m < _NEAR_M or (falling and feet_m < _NEAR_M)
        if self.clearance_m < 0.0 or self._pushed:
            self._pushed = self.clearance_m < 0.0
            self.airframe.push(push_ned_n(self.clearance_m, normal, state.velocity_ned_m_s))
        if self.crashed is None:
            if self.autopilot.airborne and not self._sets_down_on(normal):
                self.minimum_clearance_m = min(self.minimum_clearance_m, self.clearance_m)
                self._count(self._walls, self.clearance_m, normal, "the room")
            self._touch_floor(feet_m)

    def _sets_down_on(self, normal: Vector3) -> bool:
        """Whether this is a landing on a desk: a touchdown, not a collision."""
        landing = self.autopilot.landed_state is LandedState.LANDING
        return landing and normal[2] < -_LEVEL

    def _touch_floor(self, feet_m: float) -> None:
        """The floor is where take-off and landing happen; elsewhere it is an obstacle like any."""
        if self.autopilot.landed_state is LandedState.IN_AIR:
            self._count(self._floor, feet_m, _FLOOR, "the floor")
        elif feet_m <= 0.0:
            self._crash_if_fast(_FLOOR, "the floor")

    def _count(
        self, counter: ContactCounter, clearance_m: float, normal: Vector3, what: str
    ) -> None:
        if counter.update(clearance_m):
            _log.info("contact with %s at %.2f s", what, self.time_s)
            self.landing_contacts += self.autopilot.landed_state is LandedState.LANDING
            self._crash_if_fast(normal, what)

    def _crash_if_fast(self, normal: Vector3, what: str) -> None:
        speed_m_s = approach_speed_m_s(normal, self._read().velocity_ned_m_s)
        if speed_m_s > CRASH_SPEED_M_S:
            self.crashed = f"hit {what} at {speed_m_s:.1f} m/s after {self.time_s:.2f} s"
            self.fell = self._landed
            self.autopilot.terminate(self.crashed)

    def _capture(self) -> None:
        """One pose of motion capture."""
        state = self._read()
        position_ned_m = self._in_room(state.position_ned_m)
        if self.autopilot.airborne:
            self.distance_flown_m += math.dist(position_ned_m, self._captured_m)
        self._captured_m = position_ned_m
        self.mocap.append(
            MocapPose(
                stamp_ns=self.stamp_ns,
                truth_position_ned_m=position_ned_m,
                truth_ned_from_frd=quaternion_from_euler(*state.euler_rad),
                truth_clearance_m=self.clearance_m,
                truth_collisions=self.collisions,
            )
        )

    def _way_m(self, position_ned_m: Vector3, direction_ned: Vector3) -> float:
        """From a place of the feet along a direction, both in coordinates of home, to a surface."""
        north_m, east_m, down_m = self._in_room(position_ned_m)
        feet_m = north_m, east_m, down_m + self.airframe.rest_height_m
        to_floor_m = min(_FAR_M, floor_along_m(position_ned_m, direction_ned))
        return surface_along_m(self._surfaces.nearest, feet_m, direction_ned, to_floor_m)

    def _clearance(self) -> tuple[float, Vector3]:
        """Distance of the hull from the room, and the direction that leads away from it."""
        distance_m, normal = self._surfaces.nearest(self._in_room(self._read().position_ned_m))
        return distance_m - HULL_RADIUS_M, normal

    def _in_room(self, position_ned_m: Vector3) -> Vector3:
        north_m, east_m, down_m = self.room_from_home_m
        return (
            position_ned_m[0] + north_m,
            position_ned_m[1] + east_m,
            position_ned_m[2] + down_m,
        )
