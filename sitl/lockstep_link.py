"""The companion's link in lockstep: what MAVLink and MAVSDK are to the other rigs."""

from collections.abc import Callable
from typing import Final

from companion.kernel.errors import LinkError
from companion.kernel.messages import Setpoint, Telemetry
from sitl.conditions import LinkConditions, Pipe

CARRY_PERIOD_S: Final = 0.02
"""How often ``carry`` is to be called."""
TELEMETRY_PERIOD_S: Final = 1.0 / 30.0
REPEAT_PERIOD_S: Final = 0.05
"""MAVSDK sends the last setpoint again at 20 Hz."""
SILENCE_LIMIT_S: Final = 2.0
"""As the companion's MAVLink adapter has it."""


class LockstepLink:
    """Carries setpoints up and telemetry down. While its conditions are clear it takes no time;
    what is on its way when they become clear is lost.
    """

    def __init__(
        self,
        conditions: LinkConditions,
        now_s: Callable[[], float],
        measure: Callable[[], Telemetry],
        deliver: Callable[[Setpoint], None],
    ) -> None:
        self.conditions = conditions
        self._now_s = now_s
        self._measure = measure
        self._deliver = deliver
        self._setpoint: Setpoint | None = None
        self._heard: Telemetry | None = None
        self._heard_s = self._telemetry_due_s = self._repeat_due_s = 0.0
        self._up, self._down = Pipe[Setpoint](conditions, now_s), Pipe[Telemetry](conditions, now_s)

    @property
    def impaired(self) -> bool:
        """Whether it is to be carried; notices when conditions change."""
        if self.conditions.clear:
            self._heard = None
        elif self._heard is None:
            self._begin()
        return not self.conditions.clear

    def telemetry(self) -> Telemetry:
        """The newest that has come. Raises LinkError after a long silence."""
        if not self.impaired or self._heard is None:
            return self._measure()
        self.carry()
        silence_s = self._now_s() - self._heard_s
        if silence_s > SILENCE_LIMIT_S:
            raise LinkError(f"lockstep: nothing from the autopilot for {silence_s:.1f} s")
        return self._heard

    def send(self, setpoint: Setpoint) -> None:
        """Sent again and again until ``rest``, as MAVSDK does."""
        self._setpoint = setpoint
        if self.impaired:
            self._up.put(setpoint)
            self.carry()
        else:
            self._deliver(setpoint)

    def stand_still(self) -> None:
        """As the companion's adapter does before it asks for another mode."""
        if self._setpoint is not None:
            self.send(Setpoint(stamp_ns=self._setpoint.stamp_ns))

    def rest(self) -> None:
        """Another mode was commanded: no setpoint is repeated any more."""
        self._setpoint = None

    def carry(self) -> None:
        """Moves what is due."""
        now_s = self._now_s()
        while self._telemetry_due_s <= now_s:
            self._telemetry_due_s += TELEMETRY_PERIOD_S
            self._down.put(self._measure())
        while self._repeat_due_s <= now_s:
            self._repeat_due_s += REPEAT_PERIOD_S
            if self._setpoint is not None:
                self._up.put(self._setpoint)
        for setpoint in self._up.due():
            self._deliver(setpoint)
        for telemetry in self._down.due():
            self._heard, self._heard_s = telemetry, now_s

    def _begin(self) -> None:
        """What the companion knows last is the state of now."""
        now_s = self._now_s()
        self._up = Pipe[Setpoint](self.conditions, self._now_s)
        self._down = Pipe[Telemetry](self.conditions, self._now_s)
        self._heard, self._heard_s = self._measure(), now_s
        self._telemetry_due_s = now_s + TELEMETRY_PERIOD_S
        self._repeat_due_s = now_s + REPEAT_PERIOD_S
