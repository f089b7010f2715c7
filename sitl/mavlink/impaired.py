"""A UDP socket behind a bad radio link: loses, delays, overtakes and repeats datagrams."""

from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

from sitl.conditions import LinkConditions, Pipe
from sitl.mavlink.link_url import SocketAddress

READ_AT_ONCE = 64
"""Datagrams; so that a flooding client cannot stop the world."""

Datagram = tuple[bytes, SocketAddress]


class DatagramSocket(Protocol):
    """What a link does with its socket; receiving raises OSError when nothing is waiting."""

    def fileno(self) -> int: ...

    def recvfrom(self, size: int, /) -> Datagram: ...

    def sendto(self, data: bytes, address: SocketAddress, /) -> object: ...

    def close(self) -> None: ...


class ImpairedSocket:
    """Delayed datagrams leave and arrive at the next call after their time."""

    def __init__(
        self, opened: DatagramSocket, conditions: LinkConditions, now_s: Callable[[], float]
    ) -> None:
        self._socket = opened
        self._incoming = Pipe[Datagram](conditions, now_s)
        self._outgoing = Pipe[Datagram](conditions, now_s)

    def fileno(self) -> int:
        return self._socket.fileno()

    def recvfrom(self, size: int) -> Datagram:
        self._send_due()
        with suppress(OSError):  # nothing waiting, or the far end's port was closed
            for _ in range(READ_AT_ONCE):
                self._incoming.put(self._socket.recvfrom(size))
        for datagram in self._incoming.due():
            return datagram
        raise BlockingIOError

    def sendto(self, data: bytes, address: SocketAddress) -> None:
        self._outgoing.put((data, address))
        self._send_due()

    def close(self) -> None:
        self._socket.close()

    def _send_due(self) -> None:
        for data, address in self._outgoing.due():
            with suppress(OSError):  # a lost datagram
                self._socket.sendto(data, address)
