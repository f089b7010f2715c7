"""Stops the vehicle when the program that should steer it hangs.

MAVLink libraries repeat the last setpoint by themselves, so an event loop that is blocked would let
the vehicle fly on. This watch lives in a thread of its own and needs nothing of the loop.
"""

import logging
import threading
from enum import IntEnum
from typing import Protocol

from companion.kernel.clock import Clock, wall_s
from companion.kernel.errors import CompanionError
from companion.kernel.settings import Settings

logger = logging.getLogger(__name__)

LOOK_PERIOD_S = 0.01
"""Wall time between two looks; 100 ms of the vehicle's time at ten times real time."""


class DeadmanSettings(Settings, frozen=True):
    """How long setpoints may stay away."""

    stop_after_s: float = 0.5
    """On the vehicle's clock: it flies blindly until then."""
    hold_after_s: float = 2.0
    """Wall time, as the next: the vehicle stands still, and a busy host needs time to return."""
    land_after_s: float = 5.0


class DeadmanActions(Protocol):
    """Blocking calls, made from the watching thread. Each may raise CompanionError."""

    def stop(self) -> None:
        """Sends zero velocity."""
        ...

    def hold(self) -> None: ...

    def land(self) -> None: ...


class Stage(IntEnum):
    """What the deadman has done since it was last fed."""

    RESTING = 0
    WATCHING = 1
    STOPPED = 2
    HOLDING = 3
    LANDING = 4


class Deadman:
    """Rests until it is fed first; then stops, holds and lands when it is not fed again.

    After STOPPED, feeding makes it watch again. HOLDING and LANDING stay until ``rest``: the
    autopilot is in another mode by then.
    """

    def __init__(self, actions: DeadmanActions, clock: Clock, settings: DeadmanSettings) -> None:
        self._actions = actions
        self._clock = clock
        self._settings = settings
        self._lock = threading.Lock()
        self._stage = Stage.RESTING
        self._fed_s = self._fed_wall_s = 0.0
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="deadman", daemon=True)

    @property
    def stage(self) -> Stage:
        return self._stage

    def open(self) -> None:
        self._thread.start()

    def close(self) -> None:
        """Ends and joins the thread; an action that is under way is waited for."""
        self._closed.set()
        if self._thread.is_alive():
            self._thread.join()

    def feed(self) -> None:
        """A setpoint was sent."""
        with self._lock:
            self._fed_s, self._fed_wall_s = self._clock.now_s(), wall_s()
            if self._stage <= Stage.STOPPED:
                self._stage = Stage.WATCHING

    def rest(self) -> None:
        """No setpoints are expected any more."""
        with self._lock:
            self._stage = Stage.RESTING

    def _watch(self) -> None:
        while not self._closed.wait(LOOK_PERIOD_S):
            with self._lock:
                due = self._due()
                if due <= self._stage:
                    continue
                self._stage = due
                silence_s = self._clock.now_s() - self._fed_s
            logger.warning("no setpoint for %.1f s: %s", silence_s, due.name.lower())
            self._act(due)

    def _due(self) -> Stage:
        if self._stage is Stage.RESTING:
            return Stage.RESTING
        silence_wall_s = wall_s() - self._fed_wall_s
        if self._clock.now_s() - self._fed_s < self._settings.stop_after_s:
            return Stage.WATCHING
        if silence_wall_s < self._settings.hold_after_s:
            return Stage.STOPPED
        return Stage.HOLDING if silence_wall_s < self._settings.land_after_s else Stage.LANDING

    def _act(self, stage: Stage) -> None:
        actions = {
            Stage.STOPPED: self._actions.stop,
            Stage.HOLDING: self._actions.hold,
            Stage.LANDING: self._actions.land,
        }
        try:
            actions[stage]()
        except CompanionError as error:
            logger.error("deadman: %s", error)
