"""A UDP socket: one far end that is spoken to, or clients that speak first."""

import socket
from collections.abc import Callable, Sequence

from companion.kernel.clock import wall_s
from companion.kernel.errors import SimulatorError
from sitl.conditions import LinkConditions
from sitl.mavlink.impaired import DatagramSocket, ImpairedSocket
from sitl.mavlink.link_url import LOOPBACK, LinkAddress, SocketAddress, parse_link

CLIENT_SILENCE_LIMIT_S = 10.0
"""Wall time after which a client that only ever spoke first is forgotten; it beats at 1 Hz."""
MAX_CLIENTS = 16
MAX_DATAGRAM_BYTES = 2048


class UdpClient:
    """An address behind the link's socket."""

    in_stream = False

    def __init__(self, link: "UdpLink", address: SocketAddress, expected: bool) -> None:
        self._link = link
        self.address = address
        self.expected = expected
        self.heard_s = wall_s()

    def admit(self) -> bool:
        return self._link.admit(self)

    def send(self, data: bytes) -> None:
        try:
            self._link.socket.sendto(data, self.address)
        except OSError:
            return  # a lost datagram: the link is lossy by contract


class UdpLink:
    """``udpout`` has a client from the start; both kinds take up to MAX_CLIENTS more."""

    def __init__(self, url: str) -> None:
        address = parse_link(url)
        self.profile = address.profile
        opened, remote = _open(url, address)
        self.socket: DatagramSocket = opened
        self._clients: dict[SocketAddress, UdpClient] = {}
        if remote is not None:
            self._clients[remote] = UdpClient(self, remote, expected=True)
        host, port = opened.getsockname()[:2]
        self.url = url if remote else f"udpin://{host}:{port}"

    def impair(self, conditions: LinkConditions, now_s: Callable[[], float]) -> None:
        """From now on datagrams travel under these conditions; delays are of ``now_s``."""
        self.socket = ImpairedSocket(self.socket, conditions, now_s)

    @property
    def clients(self) -> Sequence[UdpClient]:
        self._forget_silent_clients()
        return tuple(self._clients.values())

    def filenos(self) -> list[int]:
        return [self.socket.fileno()]

    def receive(self) -> tuple[UdpClient, bytes] | None:
        try:
            datagram, address = self.socket.recvfrom(MAX_DATAGRAM_BYTES)
        except OSError:  # nothing waiting, or the far end's port was closed
            return None
        client = self._clients.get(address)
        if client is None:
            return UdpClient(self, address, expected=False), datagram
        client.heard_s = wall_s()
        return client, datagram

    def admit(self, client: UdpClient) -> bool:
        if client.address not in self._clients:
            self._forget_silent_clients()
            if sum(not known.expected for known in self._clients.values()) >= MAX_CLIENTS:
                return False
            self._clients[client.address] = client
        return True

    def close(self) -> None:
        self.socket.close()

    def _forget_silent_clients(self) -> None:
        limit_s = wall_s() - CLIENT_SILENCE_LIMIT_S
        for address, client in list(self._clients.items()):
            if client.heard_s < limit_s and not client.expected:
                del self._clients[address]


def _open(url: str, address: LinkAddress) -> tuple[socket.socket, SocketAddress | None]:
    """The socket, and the far end's address when it is known."""
    local, remote = (address.host, address.port), None
    try:
        if address.scheme == "udpout":  # resolve once, so that no name look-up happens in flight
            remote = _resolved(address.host, address.port)
            local = (_host_towards(remote), address.local_port)
        opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    except OSError as error:
        raise SimulatorError(f"{url}: cannot be opened: {error}") from error
    try:
        opened.bind(local)
    except OSError as error:
        opened.close()
        host, port = local
        raise SimulatorError(
            f"{url}: cannot use local port {host}:{port}: {error.strerror}"
        ) from error
    opened.setblocking(False)
    return opened, remote


def _resolved(host: str, port: int) -> SocketAddress:
    found = socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_DGRAM)[0][4]
    return str(found[0]), int(found[1])


def _host_towards(remote: SocketAddress) -> str:
    """This machine's address on the way there, so that no other network is listened to."""
    if remote[0] == LOOPBACK:
        return LOOPBACK
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect(remote)  # sends nothing
        return str(probe.getsockname()[0])
