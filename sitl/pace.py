"""How fast the world's time goes: along the wall clock, or step by step."""

import logging
from typing import Final

from companion.kernel.clock import wall_s

logger = logging.getLogger(__name__)

SLOWEST: Final = 0.1
FASTEST: Final = 100.0
LAG_LIMIT_S: Final = 0.05
"""Wall time that may be caught up with; what is more than that, the world is simply late."""
CALM_AFTER_S: Final = 1.0
"""Wall time before a lag is worth a warning: caches are cold at the start."""
IDLE_WAIT_S: Final = 0.05
"""Wall time between two looks at a world that stands still."""


class Pace:
    """Says when the next step is due; ``time_s`` is the world's."""

    def __init__(self, speed: float = 1.0, *, paused: bool = False) -> None:
        """``speed``: times real time."""
        self.speed = speed
        self._steps_left: int | None = 0 if paused else None
        """None: along the clock."""
        self._warned = False
        self.start(0.0)

    def start(self, time_s: float) -> None:
        """From now on time goes."""
        self._begin_s = wall_s()
        self._anchor(time_s)

    @property
    def paused(self) -> bool:
        """Time stands still but for steps that were asked for."""
        return self._steps_left is not None

    @property
    def idle(self) -> bool:
        """Paused, and all steps are taken."""
        return self._steps_left == 0

    def pause(self) -> None:
        self._steps_left = 0

    def step(self, count: int) -> None:
        """Pauses after so many steps, taken as fast as the machine can."""
        self._steps_left = count

    def resume(self, time_s: float) -> None:
        self._steps_left = None
        self._anchor(time_s)

    def set_speed(self, speed: float, time_s: float) -> None:
        self.speed = speed
        self._warned = False
        self._anchor(time_s)

    def due(self, time_s: float) -> bool:
        """Whether the world has to take a step now."""
        left = self._steps_left
        return time_s < self._target_s() if left is None else left > 0

    def stepped(self) -> None:
        """The world has taken one."""
        if self._steps_left is not None:
            self._steps_left -= 1

    def wait_s(self, time_s: float) -> float:
        """Wall time until the next step is due; 0 when it is."""
        if self.idle:
            return IDLE_WAIT_S
        return 0.0 if self.due(time_s) else (time_s - self._target_s()) / self.speed

    def give_up_lag(self, time_s: float) -> None:
        """The world is late, never jumps; says so once."""
        lag_s = (self._target_s() - time_s) / self.speed
        if self.paused or lag_s <= LAG_LIMIT_S:
            return
        self._anchor(time_s)
        if not self._warned and wall_s() - self._begin_s > CALM_AFTER_S:
            self._warned = True
            logger.warning(
                "this machine cannot keep up with speed %g (%.0f ms late): flying slower",
                self.speed,
                lag_s * 1e3,
            )

    def _anchor(self, time_s: float) -> None:
        self._ahead_s = time_s - wall_s() * self.speed

    def _target_s(self) -> float:
        return wall_s() * self.speed + self._ahead_s
