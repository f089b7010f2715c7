"""A listening TCP socket and the clients that have connected to it."""

import os
import socket
from collections import deque
from collections.abc import Sequence

from companion.kernel.errors import SimulatorError
from sitl.mavlink.link_url import parse_link

MAX_CLIENTS = 16
READ_BYTES = 4096
MAX_WAITING_BYTES = 256_000
"""For one client that does not read; what is more is lost, for that client alone."""


class TcpClient:
    """One connection."""

    expected = False
    in_stream = True

    def __init__(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._connection = connection
        self._waiting = bytearray()
        self.open = True

    def fileno(self) -> int:
        return self._connection.fileno()

    def send(self, data: bytes) -> None:
        """Whole blocks of frames are lost, so that the stream stays readable."""
        if not self.open or len(self._waiting) + len(data) > MAX_WAITING_BYTES:
            return
        self._waiting += data
        try:
            sent = self._connection.send(self._waiting)
        except BlockingIOError:
            return
        except OSError:
            self.close()
            return
        del self._waiting[:sent]

    def receive(self) -> bytes:
        """Empty when nothing is waiting; closes itself when the far end has."""
        try:
            data = self._connection.recv(READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self.close()
        return data

    def admit(self) -> bool:
        return self.open

    def close(self) -> None:
        self.open = False
        self._connection.close()


class TcpLink:
    def __init__(self, url: str) -> None:
        address = parse_link(url)
        self.profile = address.profile
        self._clients: deque[TcpClient] = deque()
        try:
            # SO_REUSEADDR: a port whose last connection is still winding up may be used again.
            self._listener = socket.create_server((address.host, address.port))
        except OSError as error:
            raise SimulatorError(
                f"{url}: cannot use local port {address.host}:{address.port}: "
                f"{os.strerror(error.errno or 0)}"
            ) from error
        self._listener.setblocking(False)
        host, port = self._listener.getsockname()[:2]
        self.url = f"tcpin://{host}:{port}"

    @property
    def clients(self) -> Sequence[TcpClient]:
        self._forget_closed()
        return tuple(self._clients)

    def filenos(self) -> list[int]:
        return [self._listener.fileno(), *(client.fileno() for client in self.clients)]

    def receive(self) -> tuple[TcpClient, bytes] | None:
        self._accept()
        self._forget_closed()
        for _ in range(len(self._clients)):
            client = self._clients[0]
            self._clients.rotate(-1)  # each in turn, so that none starves
            if data := client.receive():
                return client, data
        return None

    def close(self) -> None:
        for client in self._clients:
            client.close()
        self._listener.close()

    def _accept(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except OSError:  # nobody waiting, or gone again
            return
        if len(self._clients) < MAX_CLIENTS:
            self._clients.append(TcpClient(connection))
        else:
            connection.close()

    def _forget_closed(self) -> None:
        if any(not client.open for client in self._clients):
            self._clients = deque(client for client in self._clients if client.open)
