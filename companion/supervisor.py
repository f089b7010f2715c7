"""Tells the service manager how the flight goes: systemd's notification protocol (sd_notify(3)).

Each message is one datagram of ``KEY=VALUE`` lines on a unix socket. ``WATCHDOG=1`` has to come
again and again; when it does not, systemd ends the process and starts it anew.
"""

import logging
import socket
from collections.abc import Mapping
from typing import Self

from companion.kernel.clock import wall_s
from companion.kernel.errors import PlanError

PINGS_PER_LIMIT = 4
STATUS_PERIOD_S = 1.0
"""Wall time, as the watchdog's."""

logger = logging.getLogger(__name__)


class Supervisor:
    """The service manager, or nobody: then every call does nothing. It never blocks."""

    def __init__(self, address: str | None = None, watchdog_s: float | None = None) -> None:
        self._address = f"\0{address[1:]}" if address and address[0] == "@" else address
        self._ping_period_s = (
            STATUS_PERIOD_S if watchdog_s is None else watchdog_s / PINGS_PER_LIMIT
        )
        self._pinged_s = self._told_s = -STATUS_PERIOD_S

    @property
    def listens(self) -> bool:
        """Whether there is a service manager at all."""
        return self._address is not None

    @classmethod
    def from_environment(cls, environment: Mapping[str, str]) -> Self:
        """As systemd describes itself there. Raises PlanError for what it would never say."""
        limit_us = environment.get("WATCHDOG_USEC")
        if limit_us is not None and not limit_us.isdecimal():
            raise PlanError(f"WATCHDOG_USEC={limit_us}: must be a number of microseconds")
        watchdog_s = None if limit_us is None else int(limit_us) * 1e-6
        return cls(environment.get("NOTIFY_SOCKET"), watchdog_s)

    def ready(self) -> None:
        """All devices answer: about to take off."""
        self._tell("READY=1\nWATCHDOG=1")

    def alive(self) -> None:
        """To be called whenever the flight has moved on; told as often as the watchdog asks."""
        if wall_s() - self._pinged_s >= self._ping_period_s:
            self._pinged_s = wall_s()
            self._tell("WATCHDOG=1")

    def status(self, text: str) -> None:
        """One line for ``systemctl status``, told at most once per STATUS_PERIOD_S."""
        if wall_s() - self._told_s >= STATUS_PERIOD_S:
            self._told_s = wall_s()
            self._tell(f"STATUS={' '.join(text.split())}")

    def stopping(self) -> None:
        self._tell("STOPPING=1")

    def _tell(self, text: str) -> None:
        if self._address is None:
            return
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as opened:
                opened.setblocking(False)
                opened.sendto(text.encode(), self._address)
        except OSError as error:  # nobody there, or too busy to listen: no reason to stop flying
            logger.debug("%s: %s", self._address, error)
