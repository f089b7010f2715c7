"""UDP links by URL: one socket each, any number of clients behind it."""

import socket
from typing import NamedTuple
from urllib.parse import parse_qsl, urlsplit

from companion.kernel.clock import wall_s
from companion.kernel.errors import PlanError, SimulatorError

CLIENT_SILENCE_LIMIT_S = 10.0
"""Wall time after which a client that only ever spoke first is forgotten; it beats at 1 Hz."""
MAX_CLIENTS = 16
MAX_DATAGRAM_BYTES = 2048
URL_FORMS = "udpout://HOST:PORT[?local_port=PORT] or udpin://HOST:PORT"

SocketAddress = tuple[str, int]


class LinkAddress(NamedTuple):
    """``remote`` is None for a link that waits for its clients to speak first."""

    local: SocketAddress
    remote: SocketAddress | None


def parse_link(url: str) -> LinkAddress:
    """Raises PlanError for anything that is not one of the known forms."""
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
        options = dict(parse_qsl(parts.query, strict_parsing=bool(parts.query)))
        local_port = int(options.pop("local_port", "0"))
    except ValueError as error:
        raise PlanError(f"{url}: not a MAVLink link ({error}); use {URL_FORMS}") from None
    if parts.scheme == "udpin" and host and port is not None and not parts.query:
        return LinkAddress((host, port), None)
    if parts.scheme == "udpout" and host and port and not options and 0 <= local_port < 65536:
        local_host = "127.0.0.1" if host in {"127.0.0.1", "localhost"} else "0.0.0.0"
        return LinkAddress((local_host, local_port), (host, port))
    raise PlanError(f"{url}: not a MAVLink link; use {URL_FORMS}")


class UdpLink:
    """A non-blocking socket; sends to its remote and to every client heard lately."""

    def __init__(self, url: str) -> None:
        address = parse_link(url)
        self._socket = _open(url, address)
        self._remote = address.remote
        self._clients: dict[SocketAddress, float] = {}
        host, port = self._socket.getsockname()[:2]
        self.url = url if address.remote else f"udpin://{host}:{port}"

    def fileno(self) -> int:
        return self._socket.fileno()

    def receive(self) -> bytes | None:
        """The next datagram, None when there is none."""
        try:
            datagram, client = self._socket.recvfrom(MAX_DATAGRAM_BYTES)
        except OSError:  # nothing waiting, or the far end's port was closed
            return None
        if client != self._remote and (client in self._clients or self._admits_one_more()):
            self._clients[client] = wall_s()
        return datagram

    def send(self, datagram: bytes) -> None:
        if self._remote is not None:
            self._send_to(datagram, self._remote)
        if self._clients:
            self._forget_silent_clients()
            for client in self._clients:
                self._send_to(datagram, client)

    def close(self) -> None:
        self._socket.close()

    def _send_to(self, datagram: bytes, address: SocketAddress) -> None:
        try:
            self._socket.sendto(datagram, address)
        except OSError:
            return  # a lost datagram: the link is lossy by contract

    def _admits_one_more(self) -> bool:
        self._forget_silent_clients()
        return len(self._clients) < MAX_CLIENTS

    def _forget_silent_clients(self) -> None:
        limit_s = wall_s() - CLIENT_SILENCE_LIMIT_S
        for client in [c for c, heard_s in self._clients.items() if heard_s < limit_s]:
            del self._clients[client]


def _open(url: str, address: LinkAddress) -> socket.socket:
    try:
        if address.remote is not None:  # resolve once, so that no name look-up happens in flight
            socket.getaddrinfo(*address.remote, socket.AF_INET, socket.SOCK_DGRAM)
        opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    except OSError as error:
        raise SimulatorError(f"{url}: cannot be opened: {error}") from error
    try:
        opened.bind(address.local)
    except OSError as error:
        opened.close()
        host, port = address.local
        raise SimulatorError(
            f"{url}: cannot use local port {host}:{port}: {error.strerror}"
        ) from error
    opened.setblocking(False)
    return opened
