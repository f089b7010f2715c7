"""A mission: its items, and how far it has got. Places are NED from the local origin."""

import math
from collections import deque
from collections.abc import Sequence
from enum import IntEnum
from typing import Final, NamedTuple, TypeAlias

from companion.kernel.frames import Vector3

_REPORTS_KEPT: Final = 1000  # reached items that wait for a link to ask; then the oldest go


class Waypoint(NamedTuple):
    position_ned_m: Vector3
    hold_s: float = 0.0
    """Infinite for a loiter without end."""
    acceptance_m: float = math.nan
    """Level distance that counts as there; NaN for NAV_ACC_RAD."""
    yaw_rad: float = math.nan
    """NaN flies nose ahead."""


class TakeOffTo(NamedTuple):
    """Straight up, then to the level place unless that is NaN."""

    position_ned_m: Vector3
    yaw_rad: float = math.nan


class LandAt(NamedTuple):
    """On the level place, or below where it is if that is NaN."""

    position_ned_m: Vector3
    yaw_rad: float = math.nan


class ReturnToLaunch(NamedTuple):
    """Hands over to return mode: what comes after it is not flown."""


class ChangeSpeed(NamedTuple):
    speed_m_s: float


class Delay(NamedTuple):
    duration_s: float


class Jump(NamedTuple):
    """To the item ``target``, ``repeats`` times; then on to the next item."""

    target: int
    repeats: float
    """Infinite to repeat for ever."""


class TurnTo(NamedTuple):
    yaw_rad: float
    relative: bool = False


class PayloadAction(NamedTuple):
    """For a gimbal or a camera's shutter, which this vehicle does not have: done at once."""

    command: int


MissionItem: TypeAlias = (
    Waypoint
    | TakeOffTo
    | LandAt
    | ReturnToLaunch
    | ChangeSpeed
    | Delay
    | Jump
    | TurnTo
    | PayloadAction
)


class MissionState(IntEnum):
    """MAVLink's MISSION_STATE, where it exists here."""

    NO_MISSION = 1
    NOT_STARTED = 2
    ACTIVE = 3
    PAUSED = 4
    COMPLETE = 5


class MissionProgress(NamedTuple):
    """What links report; ``current`` is 0 without a mission."""

    current: int
    total: int
    state: MissionState


class Mission:
    """``current`` never rests on a jump: those are followed at once."""

    def __init__(self) -> None:
        self.reached: deque[int] = deque(maxlen=_REPORTS_KEPT)
        """Items done since a link last looked."""
        self.visits = 0
        """Grows whenever an item is begun, also when it is the same one again."""
        self.load(())

    def load(self, items: Sequence[MissionItem]) -> None:
        self.items: tuple[MissionItem, ...] = tuple(items)
        self.restart()

    def restart(self) -> None:
        """From the first item, as if it had never been flown."""
        self.begun = False
        """Whether any of it was flown."""
        self.select(0)

    def select(self, index: int) -> bool:
        """Goes on at this item, all jumps still to be taken; False if there is none such."""
        if index != 0 and not 0 <= index < len(self.items):
            return False
        self.current, self.complete = index, False
        self.speed_m_s = math.nan
        """Level speed that an item asked for; NaN for MPC_XY_CRUISE."""
        self._jumps_taken: dict[int, int] = {}
        self.visits += 1
        self._settle()
        return True

    @property
    def item(self) -> MissionItem:
        return self.items[self.current]

    def progress(self, flown: bool) -> MissionProgress:
        """``flown``: whether the vehicle is in mission mode."""
        if not self.items:
            return MissionProgress(0, 0, MissionState.NO_MISSION)
        if self.complete:
            state = MissionState.COMPLETE
        elif self.begun:
            state = MissionState.ACTIVE if flown else MissionState.PAUSED
        else:
            state = MissionState.NOT_STARTED
        return MissionProgress(self.current, len(self.items), state)

    def finish_item(self) -> None:
        """The current item is done; the next one, or the end, is reached."""
        self.reached.append(self.current)
        self.visits += 1
        if isinstance(self.item, ReturnToLaunch):
            self.complete = True
        else:
            self._step()
            self._settle()

    def _step(self) -> None:
        if self.current + 1 < len(self.items):
            self.current += 1
        else:
            self.complete = True

    def _settle(self) -> None:
        """Follows jumps; ends, because no jump leads to a jump."""
        while self.items and not self.complete and isinstance(self.item, Jump):
            taken = self._jumps_taken.get(self.current, 0)
            if taken < self.item.repeats:
                self._jumps_taken[self.current] = taken + 1
                self.current = self.item.target
            else:
                self._step()
