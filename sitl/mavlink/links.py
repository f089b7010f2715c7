"""Links by URL: byte carriers with any number of clients at their far end."""

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from companion.kernel.errors import PlanError
from sitl.conditions import LinkConditions
from sitl.mavlink.link_url import Profile, parse_link
from sitl.mavlink.serial_link import SerialLink
from sitl.mavlink.tcp_link import TcpLink
from sitl.mavlink.udp_link import UdpLink

__all__ = ["Client", "Link", "SerialLink", "TcpLink", "UdpLink", "impair", "open_link"]


class Client(Protocol):
    """One far end of a link. Compared by identity: a client that comes back is a new one."""

    @property
    def expected(self) -> bool:
        """Whether it is spoken to before it speaks."""
        ...

    @property
    def in_stream(self) -> bool:
        """Whether its bytes may be cut anywhere, not only between frames."""
        ...

    def admit(self) -> bool:
        """Makes it one of its link's clients, once it has spoken MAVLink; False: too many."""
        ...

    def send(self, data: bytes) -> None:
        """Never waits; what cannot be sent is lost, for that client alone."""
        ...


class Link(Protocol):
    @property
    def url(self) -> str:
        """With the port that was really taken."""
        ...

    @property
    def profile(self) -> Profile: ...

    @property
    def clients(self) -> Sequence[Client]:
        """Those that are there now."""
        ...

    def filenos(self) -> list[int]:
        """What to wait on for the next ``receive``."""
        ...

    def receive(self) -> tuple[Client, bytes] | None:
        """The next bytes and who sent them; None when there are none."""
        ...

    def close(self) -> None: ...


NowS = Callable[[], float]

_KINDS: Mapping[str, Callable[[str], Link]] = {
    "udpin": UdpLink,
    "udpout": UdpLink,
    "tcpin": TcpLink,
    "serial": SerialLink,
}


def open_link(url: str) -> Link:
    """Raises PlanError for a URL that is none, SimulatorError when it cannot be opened."""
    return _KINDS[parse_link(url).scheme](url)


def impair(links: Sequence[Link], conditions: Sequence[LinkConditions], now_s: NowS) -> None:
    """Puts UDP links under their conditions, which may change in flight.

    Raises PlanError for another link that is to lose or delay packets: it carries a stream.
    """
    for link, state in zip(links, conditions, strict=True):
        if isinstance(link, UdpLink):
            link.impair(state, now_s)
        elif not state.clear:
            raise PlanError(f"{link.url}: only UDP links lose or delay packets")
