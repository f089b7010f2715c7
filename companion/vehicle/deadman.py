"""Stops the vehicle when the program that should steer it hangs.

MAVLink libraries repeat the last setpoint by themselves, so an event loop that is blocked would let
the vehicle fly on. This watch lives in a thread of its own and needs nothing of the loop. What
blocks Python as a whole blocks this thread too: then a timer of the C library ends the process, the
library's threads fall silent with it, and the autopilot's own failsafe does the rest.
"""

import faulthandler
import logging
import math
import threading
from collections.abc import Callable
from enum import IntEnum
from typing import Protocol

from companion.kernel.clock import Clock, wall_s
from companion.kernel.errors import CompanionError
from companion.kernel.settings import Settings

logger = logging.getLogger(__name__)

LOOK_PERIOD_S = 0.01
"""Wall time between two looks; 100 ms of the vehicle's time at ten times real time."""
REPEAT_PERIOD_S = 0.5
"""Wall time after which an action that failed, as on a lost link, is tried again."""
STDERR = 2
"""The process's own: what stands in its place in Python may be no file that C can write to."""


class DeadmanSettings(Settings, frozen=True):
    """How long setpoints may stay away."""

    stop_after_s: float = 0.5
    """On the vehicle's clock: it flies blindly until then."""
    hold_after_s: float = 2.0
    """Wall time, as the next: the vehicle stands still, and a busy host needs time to return."""
    land_after_s: float = 5.0
    exit_after_s: float = 2.0
    """Of the watch itself: for longer than this no thread of this process may be kept waiting."""


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

    def __init__(
        self,
        actions: DeadmanActions,
        clock: Clock,
        settings: DeadmanSettings,
        now_wall_s: Callable[[], float] = wall_s,
    ) -> None:
        self._actions = actions
        self._clock = clock
        self._now_wall_s = now_wall_s
        self._settings = settings
        self._lock = threading.Lock()
        self._stage = Stage.RESTING
        self._fed_s = self._fed_wall_s = 0.0
        self._last_resort = _LastResort(settings.exit_after_s)
        self._repeat_wall_s = math.inf
        """When the last action is due again; never if it was done."""
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
            self._fed_s, self._fed_wall_s = self._clock.now_s(), self._now_wall_s()
            if self._stage <= Stage.STOPPED:
                self._stage = Stage.WATCHING

    def rest(self) -> None:
        """No setpoints are expected any more."""
        with self._lock:
            self._stage = Stage.RESTING

    def _watch(self) -> None:
        try:
            while not self._closed.wait(LOOK_PERIOD_S):
                self._look()
        finally:
            self._last_resort.rest()

    def _look(self) -> None:
        now_wall_s = self._now_wall_s()
        with self._lock:
            due = self._due()
            self._last_resort.put_off(due in (Stage.WATCHING, Stage.STOPPED))
            new = due > self._stage
            self._stage = max(due, self._stage)
            if not new and (due < self._stage or now_wall_s < self._repeat_wall_s):
                return
            silence_s = self._clock.now_s() - self._fed_s
        if new:
            logger.warning("no setpoint for %.1f s: %s", silence_s, due.name.lower())
        done = due <= Stage.WATCHING or self._act(due)
        self._repeat_wall_s = math.inf if done else now_wall_s + REPEAT_PERIOD_S

    def _due(self) -> Stage:
        if self._stage is Stage.RESTING:
            return Stage.RESTING
        silence_wall_s = self._now_wall_s() - self._fed_wall_s
        if self._clock.now_s() - self._fed_s < self._settings.stop_after_s:
            return Stage.WATCHING
        if silence_wall_s < self._settings.hold_after_s:
            return Stage.STOPPED
        return Stage.HOLDING if silence_wall_s < self._settings.land_after_s else Stage.LANDING

    def _act(self, stage: Stage) -> bool:
        """Whether it could be done."""
        actions = {
            Stage.STOPPED: self._actions.stop,
            Stage.HOLDING: self._actions.hold,
            Stage.LANDING: self._actions.land,
        }
        try:
            actions[stage]()
        except CompanionError as error:
            logger.error("deadman: %s", error)
            return False
        return True


class _LastResort:
    """Ends this process, with a trace of what hung, unless it is put off in time."""

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self._renewed_wall_s = -math.inf
        self._armed = False

    def put_off(self, needed: bool) -> None:
        """To be called often; rests where it is not ``needed``."""
        if not needed:
            self.rest()
        elif not self._armed or wall_s() - self._renewed_wall_s > self._limit_s / 8:
            faulthandler.dump_traceback_later(self._limit_s, exit=True, file=STDERR)
            self._renewed_wall_s, self._armed = wall_s(), True

    def rest(self) -> None:
        if self._armed:
            faulthandler.cancel_dump_traceback_later()
            self._armed = False
